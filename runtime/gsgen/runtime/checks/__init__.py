"""Level render of the validator: does a model draw what it should?"""
