"""3D Tiles of Gaussian splats: how is a scene that does not fit stored, read and checked?

    >>> from gsgen.tiles.loading import open_tileset
    >>> tileset = open_tileset("town/tileset.json")

A tileset is a tree of files of splats, coarse above and fine below. What is wrong with one is
a ``TilesetInvalid``, which names the file, the JSON path, what stands there and what should.
"""
