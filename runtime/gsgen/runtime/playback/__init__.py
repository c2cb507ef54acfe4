"""Playback: which input values and which camera does each frame of a video have?"""
