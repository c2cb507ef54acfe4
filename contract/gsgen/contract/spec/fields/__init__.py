"""Which fields does a model's manifest have? Its parts, input roles, and JSON Schema."""
