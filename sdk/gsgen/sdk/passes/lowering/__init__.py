"""Which operators are replaced because some GPU runtimes have no kernels for them?"""
