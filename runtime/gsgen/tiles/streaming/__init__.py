"""Streaming: which tile is asked for next, where does it stay, and what is drawn meanwhile?"""
