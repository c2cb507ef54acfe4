"""How are splats edited between reading and writing: moved, filtered, ordered, summarised?"""
