"""How are scenes of anchors exported: Scaffold-GS, Octree-GS, Duplex-GS?"""
