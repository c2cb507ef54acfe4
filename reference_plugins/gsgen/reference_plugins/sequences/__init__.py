"""How is a sequence of splat files exported, as a clip?"""
