"""The commands of `gsgen`: one module each, imported when the command runs."""
