"""Files as an attacker would write them: models, pickles, arrays and archives."""
