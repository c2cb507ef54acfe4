"""Do the segments, sound and captions of a scene file make one film? The rules GC."""
