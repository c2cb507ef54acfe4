"""How does a method become a subcommand of `gsgen export`?"""
