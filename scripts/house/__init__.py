"""Checks of the repository's style rules: figures, bars and violations.

Each module measures one subject; ``checks`` lists them with their bars, ``exceptions.toml`` holds
every exception with its reason. ``scripts/check_house.py`` is the command.
"""
