"""How does a tileset reach a viewer over a slow or faulty network?"""
