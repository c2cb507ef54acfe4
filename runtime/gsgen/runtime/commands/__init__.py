"""The runtime's commands, such as `gsgen render`, one per module."""
