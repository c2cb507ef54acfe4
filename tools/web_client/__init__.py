"""Writes the browser client's parts that come from Python: recorded GPU plans, translated rules."""
