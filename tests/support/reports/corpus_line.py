"""What the tests of the corpus say at their end, in a line: how many models, rules and slips."""

import re
from collections.abc import Iterable

_TESTS = {
    "test_a_broken_model_breaks_its_rule_and_no_other": "broken",
    "test_a_good_model_breaks_nothing": "good",
    "test_the_corpus_notices_a_silent_rule": "silenced",
}
_NAME = re.compile(r"tests/contract/rules/\S+::(\w+)\[")


def corpus_line(results: Iterable[tuple[str, bool]]) -> str:
    """Sum up tests, as (node id, passed); empty where the corpus was not among them."""
    ran = dict.fromkeys(_TESTS.values(), 0)
    failed = dict.fromkeys(_TESTS.values(), 0)
    for node, passed in results:
        found = _NAME.search(node)
        kind = _TESTS.get(found[1]) if found else None
        if kind is not None:
            ran[kind] += 1
            failed[kind] += not passed
    models = ran["good"] + ran["broken"]
    parts = []
    if models:
        slips = failed["good"] + failed["broken"]
        parts.append(f"{models} models: {ran['good']} good, {ran['broken']} broken")
        parts.append(f"cross-talk {slips}")
    if ran["silenced"]:
        noticed = ran["silenced"] - failed["silenced"]
        parts.append(f"{ran['silenced']} rules silenced one by one, {noticed} noticed")
    if models and ran["silenced"]:
        parts.append(f"matrix {models} × {ran['silenced']} = {models * ran['silenced']:,}")
    return "; ".join(parts)
