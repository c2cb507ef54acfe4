"""Good models of many producers, which the validator must not find fault with."""
