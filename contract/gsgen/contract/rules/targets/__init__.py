"""Does a model fit a target: GPU buffer limits, and the Visionary web viewer?"""
