"""What can be done with a model besides validation? Compare it, record test vectors."""
