"""What does an ONNX file hold before it runs: structure, manifest, graph, predicted placement?"""
