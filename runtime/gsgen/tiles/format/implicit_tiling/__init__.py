"""How are the tiles of an implicit quadtree or octree read and written?"""
