"""What do all splat formats share: data classes, errors, notices, axes, quantities?"""
