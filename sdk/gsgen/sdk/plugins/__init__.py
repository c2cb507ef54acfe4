"""How does a published method become a subcommand of `gsgen export`?"""
