"""Does a tileset, or the content of one tile, conform to the rules GT?"""
