"""Do statistics of valid output values suggest that the picture is not what was intended?"""
