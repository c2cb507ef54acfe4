"""Which tools work on models? Compare two models, record test vectors, check the installation."""
