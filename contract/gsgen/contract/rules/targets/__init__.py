"""Does the model fit a target: buffer limits, and the Visionary web viewer?"""
