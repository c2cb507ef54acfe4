"""The commands of `gsgen tiles`, one per module."""
