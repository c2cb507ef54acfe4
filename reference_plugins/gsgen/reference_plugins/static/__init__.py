"""How is a splat file or point cloud that does not move exported?"""
