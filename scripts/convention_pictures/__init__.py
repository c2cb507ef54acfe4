"""Draws the pictures of the conventions: one function per picture."""
