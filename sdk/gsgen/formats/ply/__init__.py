"""How are PLY files read and written, compressed ones included?"""
