"""Will the graph load, stay the same, and be captured by a GPU?"""
