"""Do the manifest and the graph inputs declare what the generator contract requires?"""
