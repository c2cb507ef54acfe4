"""Animatable avatars: GauHuman, LHM and R3-Avatar, with their checkpoints and plugins."""
