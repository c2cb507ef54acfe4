"""Which statements does the contract check on a model? One module of rules per subject."""
