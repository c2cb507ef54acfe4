import re
from dataclasses import replace

import pytest

from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.reporters.markdown import code, to_markdown
from gsgen.contract.validation.finding import Location
from gsgen.contract.validation.report import Unreadable
from support.reports.goldens import assert_is_golden
from support.reports.judged import MODELS

UNREADABLE = Unreadable("a|b.onnx", ModelUnreadable("is empty", where="a|b.onnx"))


@pytest.mark.parametrize("name", MODELS)
def test_page_matches_the_golden_file(reports, name):
    assert_is_golden(f"{name}.md", to_markdown([reports[name]]) + "\n")


def test_several_models_begin_with_a_table(reports):
    page = to_markdown([*reports.values(), UNREADABLE])
    head = page.splitlines()[:8]
    assert head[0] == "**4 models: 1 conforms, 2 invalid, 1 unreadable**"
    assert head[4:] == [
        "| `good.onnx` | ✅ conforms | 0 | 0 |",
        "| `broken.onnx` | ❌ invalid | 2 | 1 |",
        "| `foreign.onnx` | ❌ invalid | 3 | 1 |",
        r"| `a\|b.onnx` | ⛔ unreadable | | |",
    ]
    assert page.endswith("### ⛔ `a|b.onnx`\n\n`a|b.onnx: is empty`")


def test_a_crashed_rule_is_named(reports):
    outcome, *remaining = reports["good"].outcomes
    crashed = replace(outcome, status="crashed", reason="Traceback:\n  ValueError: x")
    page = to_markdown([replace(reports["good"], outcomes=(crashed, *remaining))])
    assert page.startswith("### 💥 `good.onnx`")
    assert f"**{outcome.rule.id}** crashed, a fault of the rule: ` " in page


def test_known_findings_are_counted_but_not_listed(reports):
    first, *_ = reports["broken"].findings
    known = replace(first, known=True)
    page = to_markdown([replace(reports["broken"], findings=(known,), baseline="b_1.json")])
    assert r"1 known from b\_1.json" in page
    assert first.slug not in page


@pytest.mark.parametrize(
    ("text", "span"),
    [
        ("a", "`a`"),
        ("a`b", "``a`b``"),
        ("`", "`` ` ``"),
        ("a\nb\x1b", r"`a\nb\x1b`"),
        ("@everyone <b> |", "`@everyone <b> |`"),
        ("", "`  `"),
    ],
)
def test_names_cannot_end_a_code_span(text, span):
    assert code(text) == span


def test_tensor_names_cannot_inject_markdown(reports):
    first, *_ = reports["broken"].findings
    injected_finding = replace(first, where=Location("output `</code>**@a** [x](http://b)\n# c"))
    page = to_markdown([replace(reports["broken"], findings=(injected_finding,))])
    outside = re.sub(r"(`+)(?!`).+?(?<!`)\1(?!`)", "", page)
    assert "@a" not in outside
    assert "</code>" not in outside
    assert "\n# c" not in page
