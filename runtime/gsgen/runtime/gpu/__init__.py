"""GPU memory: which scene data is on the device, how is it uploaded and read back?"""
