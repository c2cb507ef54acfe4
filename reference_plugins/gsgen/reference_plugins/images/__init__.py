"""How are networks exported that process rendered images: diffusion denoisers, style transfer?"""
