"""Imports of the documentation."""

import pytest

PRODUCT = {
    "sdk/gsgen/sdk/__init__.py": '__all__ = ["export", "math"]\n',
    "sdk/gsgen/sdk/export.py": "",
    "sdk/gsgen/sdk/math.py": "",
    "sdk/gsgen/sdk/passes.py": "",
}


def block(code, language="python"):
    return f"A page\n\n```{language}\n{code}\n```\n"


@pytest.mark.parametrize(
    "code",
    [
        "from gsgen.sdk import export",
        "import gsgen.sdk as sdk",
        "from gsgen.sdk.math import rotate",
        "import numpy",
        "from gsgen_plugin import thing",
    ],
)
def test_public_imports_pass(measure, code):
    assert measure("documentation", {**PRODUCT, "docs/a.md": block(code)}).violations == []


@pytest.mark.parametrize(
    "code",
    [
        "from gsgen.sdk.export import run",
        "import gsgen.sdk.passes",
        "from gsgen.sdk import passes",
        "from gsgen.sdk import hidden",
        "def f():\n    from gsgen.sdk.passes import split",
        "from gsgen.sdk.binding import session",
        "from gsgen.sdk.passes import split\n…",
    ],
)
@pytest.mark.parametrize("page", ["docs/deep/a.md", "README.md"])
def test_other_imports_are_reported(measure, page, code):
    result = measure("documentation", {**PRODUCT, page: block(code)})
    (violation,) = result.violations
    assert violation.path == page
    assert violation.line == 4 + code.partition("from gsgen")[0].count("\n")
    assert not result.passed


def test_examples_and_indented_blocks_are_read(measure):
    code = "from gsgen.sdk import passes\n"
    tab = '=== "Tab"\n\n    ```python\n    ' + code + "    ```\n"
    result = measure("documentation", {**PRODUCT, "docs/a.py": code, "docs/b.md": tab})
    assert [(v.path, v.line) for v in result.violations] == [("docs/a.py", 1), ("docs/b.md", 4)]


def test_blocks_in_other_languages_are_left_out(measure):
    page = block("from gsgen.sdk import passes", "text")
    assert measure("documentation", {**PRODUCT, "docs/a.md": page}).violations == []
