"""What does an ONNX file contain before it runs: manifest, graph, predicted GPU placement?"""
