"""How does a torch module become a validated ONNX file?"""
