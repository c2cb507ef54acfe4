"""How are animatable avatars exported: GART, GauHuman, LHM and R3-Avatar?"""
