"""The wgpu runtime: where validated models are drawn."""
