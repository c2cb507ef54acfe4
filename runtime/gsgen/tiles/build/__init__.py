"""Building tilesets: how does a scene of any size become a tree of tiles?"""
