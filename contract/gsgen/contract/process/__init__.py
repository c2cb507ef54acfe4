"""How does a process stay within its limits, stop with its parent, and write whole files?"""
