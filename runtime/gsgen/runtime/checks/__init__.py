"""Validation level ``render``: do the drawn frames of a model show the model?"""
