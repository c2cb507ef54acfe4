"""What does the contract define: manifest, input roles, packed layout, conventions, targets?"""
