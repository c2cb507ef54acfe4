"""Do the declared outputs have the names, types, shapes and counts of the contract?"""
