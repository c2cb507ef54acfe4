"""Does a model still compute the same when a GPU captures and replays it (level live)?"""
