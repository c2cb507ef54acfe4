"""Where do the tasks of a tileset build run: in this process, workers or a cluster?"""
