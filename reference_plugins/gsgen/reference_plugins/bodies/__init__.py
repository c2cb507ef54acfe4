"""What the plugins of people share: bodies at rest, joints in motion, Gaussians that follow."""
