"""Which splats touch each tile, and what colour do they blend to?"""
