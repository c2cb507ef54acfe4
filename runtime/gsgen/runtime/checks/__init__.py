"""Is what a model draws right (level render)?"""
