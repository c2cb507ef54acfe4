"""What does a model compute? Test inputs (probes), the sandbox that runs it, and outputs."""
