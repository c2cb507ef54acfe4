"""Where in the image does each Gaussian lie, and which colour has it?"""
