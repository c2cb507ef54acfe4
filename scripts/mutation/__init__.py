"""What changes in the code do tests miss? Sampling, choice of tests, and processes for them."""
