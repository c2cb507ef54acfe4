"""Validation rules: is an ONNX graph well formed, portable and replayable by WebGPU?"""
