"""Validation rules: do the output values of a model run describe Gaussians?"""
