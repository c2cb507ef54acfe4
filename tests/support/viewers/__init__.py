"""Viewers that draw the viewer kit: a right one, and one for each fault of the kit."""
