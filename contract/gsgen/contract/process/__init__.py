"""How does a process keep its limits, end with its parent, and write files atomically?"""
