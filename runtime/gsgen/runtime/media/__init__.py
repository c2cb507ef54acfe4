"""How are frames written as pictures and videos?"""
