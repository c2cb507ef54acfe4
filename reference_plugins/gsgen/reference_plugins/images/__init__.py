"""Networks on rendered images: denoiser and style transfer."""
