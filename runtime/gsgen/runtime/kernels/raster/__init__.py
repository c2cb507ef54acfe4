"""Hardware rasterisation: quads of splats, meshes, and the viewer's window."""
