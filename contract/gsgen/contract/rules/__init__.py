"""Which statements does the contract check? One module per subject; the catalogue lists all."""
