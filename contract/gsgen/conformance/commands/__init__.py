"""The commands `gsgen conformance`, `gsgen repro` and `gsgen viewer-kit`."""
