"""Validation rules of target runtimes: GPU buffer limits, and the Visionary web viewer."""
