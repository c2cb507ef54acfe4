"""What do all splat file formats share: data classes, errors, warnings, axes, quantities?"""
