"""What proves that a generator, a validator or a viewer keeps the contract."""
