"""What do all codecs share: splats, errors, notices, axes, quantities?"""
