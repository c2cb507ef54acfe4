"""Pictures of the conventions: each module draws some, each function one."""
