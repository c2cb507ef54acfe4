"""Does the model run on a given target: its limits, and the Visionary viewer?"""
