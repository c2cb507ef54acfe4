"""Do a model's outputs depend on camera, time, pose and run order as the contract requires?"""
