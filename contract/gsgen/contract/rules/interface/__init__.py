"""Do the manifest and the graph inputs declare what the contract requires?"""
