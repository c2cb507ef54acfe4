"""How are SOG files (splats in WebP images) read and written?"""
