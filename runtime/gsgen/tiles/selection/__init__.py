"""Selection: which tiles does a camera need, and which of them are worth their bytes and splats?"""
