"""Which data is in GPU memory, and how does it get there and back?"""
