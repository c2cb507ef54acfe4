"""Measures the validator on the whole set, or on models whose names contain a word."""

import argparse

from contract.adversarial.case import all_faults, all_right_models
from contract.adversarial.runner import measure, table

parser = argparse.ArgumentParser(prog="python -m contract.adversarial")
parser.add_argument("word", nargs="?", default="", help="only models with this in their name")
parser.add_argument("--texts", action="store_true", help="show first findings")
options = parser.parse_args()

result = measure(
    [case for case in all_faults() if options.word in case.name],
    [case for case in all_right_models() if options.word in case.name],
    lambda line: print(line, flush=True),
)
for model in result.models:
    for promise in model.broken_promises:
        print("BROKEN", promise)
    if options.texts and model.first_text:
        print(f"{model.name}: {model.first} {model.first_text}")
print()
print(table(result))
