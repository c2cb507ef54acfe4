"""Do the numbers of one run describe Gaussians?"""
