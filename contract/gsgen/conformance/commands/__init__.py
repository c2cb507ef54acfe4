"""The commands that come with the conformance suite, one module each."""
