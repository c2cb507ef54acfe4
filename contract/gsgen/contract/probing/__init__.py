"""Runs models on test inputs (probes) in a sandbox, and keeps their outputs for rules."""
