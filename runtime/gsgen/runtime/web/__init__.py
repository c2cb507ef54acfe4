"""How does a browser draw what Python draws: recorded GPU plans, and the web page's modules?"""
