"""Networks of image diffusion in torch, laid out as the checkpoints of diffusers name them."""
