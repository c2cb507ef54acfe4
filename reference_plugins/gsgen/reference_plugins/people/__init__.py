"""How are animatable avatars exported: GauHuman, LHM and R3-Avatar?"""
