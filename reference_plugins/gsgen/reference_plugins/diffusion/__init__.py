"""Which networks of image diffusion can be read from checkpoints, and which LoRA files?"""
