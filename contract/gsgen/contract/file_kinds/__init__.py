"""What is this file? Tells kinds of files apart by their first bytes, for error messages."""
