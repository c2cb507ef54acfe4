"""How does a splat scene of any size become a tileset?"""
