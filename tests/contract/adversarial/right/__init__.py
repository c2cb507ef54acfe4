"""Right models, a module for each tool that makes them; importing a module adds its models."""
