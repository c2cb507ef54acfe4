"""Validation: does a tileset, or the content of one tile, keep the rules GT?"""
