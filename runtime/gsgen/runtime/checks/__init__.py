"""Are the frames that a model draws valid (level render)?"""
