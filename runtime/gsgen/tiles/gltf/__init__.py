"""glTF in tiles: how are the splats of a tile stored, turned and decoded?"""
