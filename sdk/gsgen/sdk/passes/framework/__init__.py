"""What do all passes share: building nodes, facts about values, refusing to rewrite?"""
