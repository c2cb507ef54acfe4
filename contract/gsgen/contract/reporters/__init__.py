"""Reports in the forms that people and programs read; each takes a report and gives text."""
