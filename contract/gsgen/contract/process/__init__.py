"""How does a process limit its resources, end with its parent, and write files atomically?"""
