"""What does a model compute: with which inputs is it run, where, and what came out?"""
