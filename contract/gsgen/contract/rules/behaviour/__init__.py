"""How do outputs change from run to run, and with camera, time and pose?"""
