"""How are the JSON documents of a tileset found, counted and checked?"""
