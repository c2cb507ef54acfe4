"""How does a generator become a tile, with content for viewers that cannot run it?"""
