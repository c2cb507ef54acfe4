"""The viewer kit: small generators with their right pictures, which a viewer is judged by."""
