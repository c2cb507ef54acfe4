"""How are splats changed between reading and writing: moved, filtered, ordered, summarised?"""
