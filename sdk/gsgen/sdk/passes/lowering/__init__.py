"""Which operators are written as others that every GPU runtime has?"""
