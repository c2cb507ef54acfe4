"""How are operators that select rows rewritten so that shapes stay static?"""
