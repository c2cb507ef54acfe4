"""Faulty models that were written after the rules had been changed for the first ones."""
