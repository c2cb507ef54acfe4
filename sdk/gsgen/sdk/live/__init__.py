"""Does a model compute the same if a GPU captures and replays it (level live)?"""
