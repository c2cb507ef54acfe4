"""Which graph nodes can be removed or merged without changing the outputs?"""
