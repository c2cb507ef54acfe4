"""How are operators that select rows by a mask, or work on columns, rewritten with static shapes?"""
