"""What is drawn: scene, splats, meshes, cameras, frames, colours?"""
