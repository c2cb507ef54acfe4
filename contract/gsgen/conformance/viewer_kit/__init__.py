"""The viewer test kit: small models with expected pictures, to check a viewer's pictures."""
