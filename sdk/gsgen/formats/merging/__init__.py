"""How are many Gaussians merged into few that look the same from afar?"""
