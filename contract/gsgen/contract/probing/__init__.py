"""What does a model compute? Probe inputs, the sandbox that runs the model, and its outputs."""
