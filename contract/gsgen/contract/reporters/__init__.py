"""How is a report presented? One module per output format; each turns reports into text."""
