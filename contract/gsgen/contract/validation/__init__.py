"""How is a model validated? Rules, findings, settings, engine and report."""
