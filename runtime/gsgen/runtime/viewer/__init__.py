"""Viewer: how does `gsgen view` show a scene in a window?"""
