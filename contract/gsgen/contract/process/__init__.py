"""How does a process limit its resources, end with its parent, read arrays and write files?"""
