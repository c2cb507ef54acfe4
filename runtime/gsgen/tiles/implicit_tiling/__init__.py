"""Implicit tiling: which tiles does a tree have whose tiles are not written out?"""
