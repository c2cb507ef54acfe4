"""How is a model validated? Rules, findings, settings, validation engine and report."""
