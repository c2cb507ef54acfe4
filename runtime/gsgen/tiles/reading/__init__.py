"""Reading: how are the documents of a tileset found, counted and checked?"""
