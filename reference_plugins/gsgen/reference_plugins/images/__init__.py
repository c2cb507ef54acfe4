"""Post-process networks for rendered images: diffusion denoisers and style transfer."""
