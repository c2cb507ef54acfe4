"""What else can be done with a model: compare, record vectors, check the installation?"""
