"""Stores: where do the files of a tileset lie, and how are they read?"""
