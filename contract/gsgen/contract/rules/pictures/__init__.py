"""Do valid output values draw what the author meant, as far as statistics tell?"""
