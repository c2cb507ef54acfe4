"""Validation rules: do the manifest and graph inputs declare what the contract requires?"""
