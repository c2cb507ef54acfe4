"""How is a model validated: rule, finding, settings, engine, report?"""
