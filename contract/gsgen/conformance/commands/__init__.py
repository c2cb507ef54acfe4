"""The commands of the conformance suite: `gsgen conformance`, `gsgen repro`, `gsgen viewer-kit`."""
