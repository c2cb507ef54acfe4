"""The runtime's commands, one per module."""
