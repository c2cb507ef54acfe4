"""Positional fields, positional booleans, and ``Any``."""

import pytest

FIELDS = "".join(f"    field_{number}: int\n" for number in range(5))
FOUR = "".join(f"    field_{number}: int\n" for number in range(4))


@pytest.mark.parametrize(
    "code",
    [
        f"@dataclass\nclass A:\n{FOUR}",
        f"@dataclass(frozen=True, kw_only=True)\nclass A:\n{FIELDS}",
        f"@dataclass\nclass A:\n    _: KW_ONLY\n{FIELDS}",
        f"@dataclass\nclass A:\n{FOUR}    e: ClassVar[int] = 1\n    f: int = field(init=False)\n",
        f"@dataclass\nclass A:\n{FOUR}    e: int = field(kw_only=True)\n",
        f"class A:\n{FIELDS}",
        f"@dataclass(kw_only=True)\nclass A:\n{FIELDS}@dataclass\nclass B(A):\n    e: int\n",
        f"class A(NamedTuple):\n{FIELDS}a = A(field_0=1, **more)\nb = A(*row)\n",
        f"class A(NamedTuple):\n{FOUR}a = A(1, 2, 3, 4)\n",
    ],
)
def test_few_fields_and_named_fields_pass(measure, code):
    assert measure("fields", {"sdk/a.py": code}).violations == []


@pytest.mark.parametrize(
    ("code", "line"),
    [
        (f"@dataclass\nclass A:\n{FIELDS}", 2),
        (f"@dataclasses.dataclass(frozen=True, kw_only=False)\nclass A:\n{FIELDS}", 2),
        (f"@dataclass\nclass A:\n{FOUR}    e: int = field(default=1)\n", 2),
        (f"@dataclass\nclass A:\n{FOUR}@dataclass\nclass B(A):\n    e: int\n", 8),
        (f"class A(NamedTuple):\n{FIELDS}a = A(1, 2, field_2=1)\n", 7),
        (f"class A(typing.NamedTuple):\n{FIELDS}a = module.A(1)\n", 7),
    ],
)
def test_five_positional_fields_are_reported(measure, code, line):
    result = measure("fields", {"sdk/a.py": code})
    assert [violation.line for violation in result.violations] == [line]
    assert not result.passed


@pytest.mark.parametrize(
    "signature",
    ["a: bool", "a=True", "x, a: bool = False", "a: bool, /", "self, x, a: bool | None = None"],
)
def test_a_positional_boolean_is_reported(measure, signature):
    result = measure("booleans", {"sdk/a.py": f"def f({signature}): pass"})
    assert [violation.subject for violation in result.violations] == ["f.a"]


@pytest.mark.parametrize(
    "code",
    [
        "def f(*, a: bool): pass",
        "def f(x=1, *, a=False): pass",
        "def f(a: Annotated[bool, typer.Option()] = False, b: bool = True): pass",
        "class A:\n    @a.setter\n    def a(self, value: bool): pass",
        "def f(a: list[bool]): pass",
    ],
)
def test_booleans_that_callers_name_pass(measure, code):
    assert measure("booleans", {"sdk/a.py": code}).violations == []


def test_tests_may_pass_booleans_by_position(measure):
    assert measure("booleans", {"tests/test_a.py": "def f(a: bool): pass"}).violations == []


@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("def f(a: Any) -> Any: pass", 2),
        ("def f(a: 'dict[str, Any]'): pass", 1),
        ("a: list[Any] = []", 1),
        ("a: typing.Any", 1),
        ("from typing import Any", 0),
        ("'''Any value.'''", 0),
        ("def f(a: object): pass", 0),
    ],
)
def test_any_is_counted_in_the_runtime(measure, line, count):
    result = measure("any", {"runtime/a.py": f"{line}\n" + "\n" * 98, "sdk/a.py": line})
    assert len(result.violations) == count
    assert result.figure == pytest.approx(count * 10)
    assert result.passed is (count == 0)


def test_four_in_a_thousand_lines_pass(measure):
    code = "a: Any\n" * 4 + "\n" * 995
    assert measure("any", {"runtime/a.py": code}).passed
