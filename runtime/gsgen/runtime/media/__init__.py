"""Media files: how are drawn frames written as image files and videos?"""
