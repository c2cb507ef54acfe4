"""How are SPZ files read and written?"""
