"""Exports head avatars that a face model moves, such as GaussianAvatars."""
