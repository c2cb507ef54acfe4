"""Do the declared outputs have the names, types, shapes and counts that the contract requires?"""
