"""Validation rules: do statistics of valid outputs suggest a picture that was not intended?"""
