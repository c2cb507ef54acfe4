"""What does the contract say: manifest, roles, layout, conventions, targets?"""
