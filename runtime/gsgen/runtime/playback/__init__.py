"""Which frame is drawn when: times, inputs, poses, cameras, sequences?"""
