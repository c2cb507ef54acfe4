"""Is an ONNX graph well formed and portable, and can WebGPU record it once and replay it?"""
