"""How are PLY files read and written, including compressed ones?"""
