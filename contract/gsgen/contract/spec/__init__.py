"""What does the contract define: manifest, roles, packed layout, conventions, targets?"""
