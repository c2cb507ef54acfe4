"""Does a tileset, or the content of one tile, conform to the validation rules GT?"""
