"""How are checkpoints of Octree-AnyGS read, whose Gaussians are neural, explicit or flat?"""
