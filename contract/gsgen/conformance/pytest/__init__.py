"""How does pytest run the conformance suites? The pytest plugin, its items and base class."""
