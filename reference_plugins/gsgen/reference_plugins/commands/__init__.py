"""The `gsgen export` subcommands of the plugins, one module each; importing them imports no torch."""
