"""GPU memory: which scene data is on the device, how it is uploaded and read back?"""
