"""People: GauHuman, LHM and R3-Avatar."""
