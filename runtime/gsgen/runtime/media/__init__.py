"""How are pictures and films written?"""
