"""How does a torch module become an ONNX graph, and which of its operations cannot?"""
