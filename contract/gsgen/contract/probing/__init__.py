"""What does a model compute? Probes, the sandbox that runs them, and the outputs."""
