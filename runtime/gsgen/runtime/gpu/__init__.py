"""What lies in GPU memory, and how does it get there and back?"""
