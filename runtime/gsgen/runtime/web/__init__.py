"""How does a browser draw what Python draws: the frame plan as data, and the page's modules?"""
