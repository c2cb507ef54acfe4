"""Reads an ONNX file without running it: manifest, graph, and predicted GPU placement."""
