"""How does `gsgen view` show a scene in a window?"""
