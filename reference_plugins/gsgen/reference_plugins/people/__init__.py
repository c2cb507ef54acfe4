"""How are avatars that poses animate exported: GauHuman, LHM and R3-Avatar?"""
