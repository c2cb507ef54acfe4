"""How does an ONNX generator become a tile, with splats for viewers that run no models?"""
