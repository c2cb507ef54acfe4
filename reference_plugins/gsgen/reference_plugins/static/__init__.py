"""How are static splat files and point clouds exported?"""
