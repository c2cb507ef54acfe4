"""Networks of image diffusion and their LoRA files, named as in checkpoints of diffusers."""
