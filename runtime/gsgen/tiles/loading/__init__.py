"""How are a tileset and its contents read from a store, and what do they hold?"""
