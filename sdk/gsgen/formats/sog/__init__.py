"""How are SOG archives read?"""
