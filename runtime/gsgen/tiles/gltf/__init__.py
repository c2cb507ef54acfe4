"""How is the glTF content of a tile encoded, rotated and decoded?"""
