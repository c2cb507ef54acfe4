"""Which statements does the contract check? A module a subject; the catalogue lists them all."""
