"""Tools for models: compare two models, record test vectors; and checks of the installation."""
