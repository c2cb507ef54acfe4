"""Sources: from which files, ONNX generators or scenes do Gaussians and meshes come?"""
