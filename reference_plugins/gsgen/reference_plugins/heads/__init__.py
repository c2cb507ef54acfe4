"""How are head avatars exported that a face model moves: GaussianAvatars?"""
