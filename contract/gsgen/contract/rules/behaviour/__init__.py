"""Validation rules: do outputs depend on camera, time, pose and run order as required?"""
