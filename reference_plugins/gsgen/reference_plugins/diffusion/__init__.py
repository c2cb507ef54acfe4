"""Which image diffusion networks and LoRA files can be read?"""
