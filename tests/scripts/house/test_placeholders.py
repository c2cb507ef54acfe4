"""Placeholder names, and the bindings among which they are counted."""

import ast

import pytest
from house.bindings import bindings
from house.placeholders import WORDS

BINDINGS = """
import os
LIMIT: int = 1
async def outer(first, /, second=1, *third, fourth: int, **fifth):
    global counter
    counter = first
    for sixth, (seventh, *eighth) in second:
        with open(third) as ninth:
            pass
    try:
        pass
    except OSError as tenth:
        pass
    def inner():
        nonlocal sixth
        sixth = 1
    match fourth:
        case {"key": eleventh, **twelfth}:
            pass
        case [thirteenth, *fourteenth] as fifteenth:
            pass
    return [sixteenth for sixteenth in fifth if (seventeenth := sixteenth)], lambda eighteenth: 0
class Box:
    size: int
    def __init__(self, size):
        self.size = size
        self.weight, _ = 1, 2
"""


def test_every_kind_of_binding_is_found_once_in_its_scope():
    names = sorted((name.scope, name.name, name.kind) for name in bindings(ast.parse(BINDINGS)))
    parameters = ["first", "second", "third", "fourth", "fifth", "eighteenth"]
    variables = ["sixth", "seventh", "eighth", "ninth", "tenth", "eleventh", "twelfth"]
    variables += ["thirteenth", "fourteenth", "fifteenth", "seventeenth"]
    expected = [("", "LIMIT", "variable"), ("outer", "sixteenth", "comprehension")]
    expected += [("outer", name, "parameter") for name in parameters]
    expected += [("outer", name, "variable") for name in variables]
    expected += [("Box", "size", "attribute"), ("Box", "weight", "attribute")]
    expected += [("Box.__init__", "size", "parameter")]
    assert names == sorted(expected)


@pytest.mark.parametrize(
    "line",
    [
        "made = 1",
        "_MADE2 = 1",
        "def f(made): pass",
        "x = [made for made in y]",
        "x = lambda made: 0",
        "class A:\n    made: int",
        "for made in x: pass",
        "with x as made: pass",
        "f = (made := 1)",
    ],
)
def test_a_placeholder_is_reported_with_its_line_and_a_hint(measure, line):
    result = measure("placeholders", {"sdk/a.py": f"node = 1\n{line}\n"})
    (violation,) = result.violations
    assert violation.line in (2, 3)
    assert "made" in violation.actual.lower()
    assert violation.hint == WORDS["made"]
    assert not result.passed


@pytest.mark.parametrize(
    "code",
    [
        "entry = made_of = result = 1",
        "class A:\n    def __eq__(self, other): pass",
        "left, right = 1, 2",
        "import a as made",
    ],
)
def test_names_with_a_meaning_pass(measure, code):
    assert measure("placeholders", {"sdk/a.py": code}).violations == []


@pytest.mark.parametrize(
    "code", ["left = 1", "def compare(other): pass", "def f():\n    left = 1\nright = 2"]
)
def test_the_meaning_must_stand_in_the_same_scope(measure, code):
    assert len(measure("placeholders", {"sdk/a.py": code}).violations) == 1


@pytest.mark.parametrize(("others", "passed"), [(99, True), (98, False)])
def test_one_binding_in_a_hundred_may_be_a_placeholder(measure, others, passed):
    names = "".join(f"name_of_{number} = 1\n" for number in range(others))
    names = names.replace("name_of_", "name_")
    result = measure("placeholders", {"sdk/a.py": names.replace(" = 1", "_a = 1") + "made = 1"})
    assert result.passed is passed
    assert result.figure == pytest.approx(100 / (others + 1))


def test_tests_have_a_figure_of_their_own_and_no_bar(measure):
    files = {"tests/test_a.py": "made = 1", "sdk/a.py": "entry = 1"}
    assert measure("placeholders", files).figure == 0
    result = measure("placeholders-in-tests", files)
    assert (result.figure, result.passed, result.check.bar) == (100, True, None)


def test_every_word_has_a_hint():
    assert all(len(hint) > 3 and word.islower() for word, hint in WORDS.items())
