"""Functions and files that are too long."""

import pytest


@pytest.mark.parametrize(("lines", "passed"), [(2, True), (80, True), (81, False)])
@pytest.mark.parametrize("kind", ["def", "async def"])
def test_a_function_has_at_most_eighty_lines(measure, kind, lines, passed):
    body = "".join("        x = 1\n" for _ in range(lines - 1))
    code = f"class A:\n    @decorated(\n    1)\n    {kind} long(self):\n{body}"
    result = measure("functions", {"tests/test_a.py": code})
    assert result.passed is passed
    assert [(v.subject, v.line) for v in result.violations] == ([] if passed else [("A.long", 4)])


def test_a_function_inside_of_another_counts_for_both(measure):
    inner = "".join("            x = 1\n" for _ in range(90))
    code = f"def outer():\n    if True:\n        def inner():\n{inner}"
    names = {violation.subject for violation in measure("functions", {"sdk/a.py": code}).violations}
    assert names == {"outer", "outer.inner"}


@pytest.mark.parametrize(("lines", "passed"), [(500, True), (501, False)])
def test_a_file_has_at_most_five_hundred_lines(measure, lines, passed):
    result = measure("files", {"scripts/a.py": "x = 1\n" * lines})
    assert result.passed is passed
