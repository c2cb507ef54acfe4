"""Where do the tasks of a build run? No byte of the result depends on the engine."""
