"""Do the numbers draw what their author meant, as far as statistics of the picture tell?"""
