"""What do render pipelines draw: quads of splats, meshes, the window?"""
