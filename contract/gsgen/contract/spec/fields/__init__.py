"""Which fields does a manifest have? Its parts by subject, input roles, and JSON Schema."""
