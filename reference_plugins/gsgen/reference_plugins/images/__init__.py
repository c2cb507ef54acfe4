"""How are networks exported that post-process rendered images: denoisers, style transfer?"""
