"""What do the files of a tileset say: JSON, metadata, volumes, neural tiles, implicit trees?"""
