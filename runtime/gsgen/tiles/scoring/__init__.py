"""How well does each level of a tileset look, for how many bytes?"""
