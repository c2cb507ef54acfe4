"""Merging: how do many Gaussians become few that look the same from afar?"""
