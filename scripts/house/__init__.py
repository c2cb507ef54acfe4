"""Which rules of style does this repository keep, and where does it break them?

Each module measures one subject; ``checks`` lists them with their bars, ``exceptions.toml`` holds
every exception with its reason. ``scripts/check_house.py`` is the command.
"""
