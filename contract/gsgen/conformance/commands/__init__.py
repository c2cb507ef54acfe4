"""The commands of the conformance suite: `gsgen conformance` and `gsgen repro`."""
