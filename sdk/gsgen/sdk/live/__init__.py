"""Does a model compute the same in WebGPU, captured and replayed (validation level ``live``)?"""
