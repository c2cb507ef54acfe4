"""A rule that falls silent is noticed: its fixture no longer reports what it should."""

from collections.abc import Iterator
from dataclasses import replace

import pytest

from gsgen.conformance.fixtures import example_model_of_rule, find
from gsgen.contract.rules.catalogue import builtin_rules
from gsgen.contract.validation.finding import Violation
from gsgen.contract.validation.gates import AT_MOMENTS
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.contract.validator import validate


def silent_check(_: object) -> Iterator[Violation]:
    """Find nothing, whatever there is."""
    yield from ()


@pytest.mark.parametrize("rule", builtin_rules(), ids=lambda rule: rule.id)
def test_corpus_fails_when_a_rule_is_silent(rule: Rule, tmp_path):
    fixture = find(example_model_of_rule(rule.id))
    rules = [
        replace(entry, check=silent_check) if entry is rule else entry for entry in builtin_rules()
    ]
    if rule.id == AT_MOMENTS:  # its checks are those of other rules, too
        rules = [replace(entry, at_moments=False) for entry in rules]
    settings = replace(fixture.settings, level=rule.level)
    report = validate(fixture.write(tmp_path), settings, registry=Registry.from_rules(rules))
    assert {finding.rule for finding in report.findings} != {rule.id}
