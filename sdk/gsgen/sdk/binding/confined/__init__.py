"""How does a model of a stranger run in a confined child process, with rows in shared memory?"""
