"""The viewer kit: small generators with their right pictures, which those of a viewer are compared with."""
