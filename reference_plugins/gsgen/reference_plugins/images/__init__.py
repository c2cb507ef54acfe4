"""Exports networks that post-process rendered images, such as denoisers and style transfer."""
