"""How does a generator become a tile, with splats for viewers that cannot run models?"""
