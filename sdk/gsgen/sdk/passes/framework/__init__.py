"""What do all passes share: base classes, graph building, facts about values?"""
