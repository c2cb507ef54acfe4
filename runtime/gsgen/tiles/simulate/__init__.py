"""Simulation: how would a tileset stream along a path, over a network, on a virtual clock?"""
