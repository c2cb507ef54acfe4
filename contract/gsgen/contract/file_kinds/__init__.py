"""Which kind of file is this, by its first bytes? For error messages, and for opening files."""
