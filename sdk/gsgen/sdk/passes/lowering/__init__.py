"""Which operators are replaced by others that every GPU runtime has kernels for?"""
