"""How are anchor-based methods exported: Scaffold-GS, Octree-GS, Duplex-GS?"""
