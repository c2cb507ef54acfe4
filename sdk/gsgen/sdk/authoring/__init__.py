"""How does an author write a generator of Gaussians or a post-process model in torch?"""
