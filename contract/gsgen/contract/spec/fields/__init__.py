"""Which fields does a manifest have? The dataclasses of its parts, by subject."""
