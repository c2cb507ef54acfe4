"""Does a model compute the same when WebGPU captures and replays it (validation level ``live``)?"""
