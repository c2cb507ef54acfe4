"""What can be drawn: scenes of splats and meshes, cameras, frames and colours?"""
