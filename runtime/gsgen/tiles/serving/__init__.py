"""Serving: how does a tileset reach a viewer, over a network as good or bad as one likes?"""
