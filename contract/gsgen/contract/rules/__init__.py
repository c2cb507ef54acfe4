"""Which statements about a model does the contract check? One module of rules per subject."""
