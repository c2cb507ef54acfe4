"""Which commands come with the contract? One module per command."""
