"""Faulty models, a module for each family of mistakes; importing a module adds its models."""
