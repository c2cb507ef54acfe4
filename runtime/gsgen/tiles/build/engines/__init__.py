"""Engines: who runs the tasks of a build? No byte of the result depends on the answer."""
