"""The contract package's commands: validate, inspect, diff, rules, explain, vectors, doctor."""
