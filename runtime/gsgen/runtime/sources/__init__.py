"""Where do the Gaussians and meshes of a frame come from: files, generators, scenes?"""
