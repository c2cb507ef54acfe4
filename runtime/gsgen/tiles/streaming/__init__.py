"""Which tile is requested next, where is it stored, and what is drawn meanwhile?"""
