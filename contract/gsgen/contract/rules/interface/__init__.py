"""Do the manifest and the inputs declare what the contract requires?"""
