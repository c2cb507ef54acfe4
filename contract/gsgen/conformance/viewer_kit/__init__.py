"""The viewer kit: small test models with expected pictures, to check the pictures of a viewer."""
