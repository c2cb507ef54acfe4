"""What do all graph rewrites share: base classes, graph building, facts about values?"""
