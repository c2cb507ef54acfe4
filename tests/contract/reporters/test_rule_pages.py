import json
from dataclasses import replace

import pytest

from gsgen.contract.reporters.rule_pages import FAMILY_TITLES, help_path, index, page, to_dict
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.rule import Registry
from gsgen.tiles.validation.rules import all_rules
from support.reports.rules import made_up

FIRST = made_up("GV901")
SECOND_RULE = made_up(
    "GV902", severity=Severity.WARNING, needs=("GV901",), kinds=MANIFEST_KINDS, limit="rows"
)
THIRD_RULE = made_up("acme/AC001", target="webgpu")
REGISTRY = Registry.from_rules([FIRST, SECOND_RULE, THIRD_RULE])

PAGE = """\
# GV902 made-up-gv902

Something holds.

- severity: warning
- level: static
- applies to: gaussian-generator, post-process, trajectory-predictor
- target: those with a limit rows
- needs: GV901 made-up-gv901
- example that breaks it: `none`

## Why

Because.

## How to repair it

Make it so.
"""

INDEX = """\
# Rules

3 rules, one page each.


## Values (GV)

| rule | severity | level | what must hold |
|---|---|---|---|
| [GV901 made-up-gv901](GV901.md) | error | static | Something holds. |
| [GV902 made-up-gv902](GV902.md) | warning | static | Something holds. |

## AC (AC)

| rule | severity | level | what must hold |
|---|---|---|---|
| [acme/AC001 made-up-acme-ac001](acme-AC001.md) | error | static | Something holds. |
"""


def test_a_page_says_all_that_the_rule_declares():
    assert page(SECOND_RULE, REGISTRY, "none") == PAGE


def test_a_page_leaves_out_what_the_rule_does_not_declare():
    text = page(FIRST, REGISTRY, "")
    assert "- target: all\n" in text
    assert "needs" not in text
    assert "- target: webgpu\n" in page(THIRD_RULE, REGISTRY, "")


def test_page_shows_the_observed_failure_of_the_rule():
    with_evidence = replace(SECOND_RULE, evidence="In a viewer.")
    assert page(with_evidence, REGISTRY, "none") == f"{PAGE}\n## Evidence\n\nIn a viewer.\n"


def test_only_our_own_rules_have_a_page_of_ours():
    assert help_path(FIRST) == "rules/GV901.md"
    assert help_path(THIRD_RULE) == ""


def test_the_index_lists_rules_by_family():
    assert index(REGISTRY) == INDEX


def test_every_family_of_ours_has_a_name():
    assert {rule.family for rule in all_rules().rules.values()} <= set(FAMILY_TITLES)


@pytest.mark.parametrize("rule", all_rules().rules.values(), ids=all_rules().rules)
def test_every_rule_has_a_page(rule):
    text = page(rule, all_rules(), "")
    assert text.startswith(f"# {rule.id} {rule.slug}\n\n{rule.statement}\n\n- severity: ")
    assert "None" not in text.split("## Why")[0]


def test_rule_converts_to_json_types():
    data = json.loads(json.dumps(to_dict(SECOND_RULE, "none")))
    assert data == {
        "id": "GV902",
        "slug": "made-up-gv902",
        "severity": "warning",
        "level": "static",
        "statement": "Something holds.",
        "why": "Because.",
        "hint": "Make it so.",
        "fixture": "none",
        "needs": ["GV901"],
        "kinds": list(MANIFEST_KINDS),
        "target": None,
        "evidence": None,
    }
