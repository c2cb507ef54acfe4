"""What do the writers of synthetic checkpoints share: a scene, random weights, run files?"""
