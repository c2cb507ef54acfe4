"""Does a model fit a target runtime: GPU buffer limits, and the Visionary web viewer?"""
