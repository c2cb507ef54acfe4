"""Which tiles does a camera need, and which of them are worth their bytes and splats?"""
