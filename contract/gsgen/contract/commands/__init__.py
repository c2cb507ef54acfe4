"""The commands that come with the contract, one module each."""
