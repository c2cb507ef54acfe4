"""How is a validation report presented? One module per output format."""
