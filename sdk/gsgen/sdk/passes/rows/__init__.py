"""How is selection of rows by a boolean mask rewritten with static shapes?"""
