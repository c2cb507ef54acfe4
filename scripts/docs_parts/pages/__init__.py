"""Which text do whole pages have that are generated: of rules, of the tutorial?"""
