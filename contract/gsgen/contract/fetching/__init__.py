"""How is a file read from a web server, within a deadline and a byte budget?"""
