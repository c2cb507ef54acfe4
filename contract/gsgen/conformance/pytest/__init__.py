"""How does pytest run the conformance suites?"""
