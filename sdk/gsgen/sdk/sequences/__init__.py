"""How does a sequence of frames, whose rows correspond, become one small generator (a clip)?"""
