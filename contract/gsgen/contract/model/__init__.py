"""What does a model file hold, before it is run?"""
