"""How does an author write a generator or a post-process model in torch?"""
