"""Does a tileset, or the content of one tile, conform to the rules for tilesets (ids GT…)?"""
