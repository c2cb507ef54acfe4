"""Where are the files of a tileset, and how are they read?"""
