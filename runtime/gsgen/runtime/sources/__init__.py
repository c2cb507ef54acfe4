"""Sources: from which files, generators or scenes do Gaussians and meshes come?"""
