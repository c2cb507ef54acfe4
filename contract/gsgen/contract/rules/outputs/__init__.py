"""Validation rules: do declared outputs have the required names, types, shapes and counts?"""
