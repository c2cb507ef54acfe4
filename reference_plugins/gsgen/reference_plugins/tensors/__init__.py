"""Which tensor operations do several export plugins share?"""
