"""Which tensor operations do several families share?"""
