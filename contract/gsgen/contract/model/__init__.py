"""What can be read from an ONNX file without running it: manifest, graph, GPU placement?"""
