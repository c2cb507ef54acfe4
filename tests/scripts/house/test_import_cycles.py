"""Import cycles, wherever the import stands."""

import pytest
from house.import_cycles import strong_components
from hypothesis import given
from hypothesis import strategies as st

A, B, C = (f"sdk/gsgen/sdk/{name}.py" for name in "abc")


@pytest.mark.parametrize(
    "line",
    [
        "from gsgen.sdk import a",
        "from gsgen.sdk.a import name",
        "import gsgen.sdk.a",
        "def f():\n    from gsgen.sdk.a import name",
        "if TYPE_CHECKING:\n    import gsgen.sdk.a",
        "import importlib\nmodule = importlib.import_module('gsgen.sdk.a')",
    ],
)
def test_a_cycle_is_found_wherever_the_import_stands(measure, line):
    result = measure("cycles", {A: "import gsgen.sdk.b\n", B: line})
    (violation,) = result.violations
    assert f"{A}:1 imports gsgen.sdk.b" in violation.actual
    assert f"{B}:" in violation.actual


def test_imports_that_point_downwards_pass(measure):
    files = {
        A: "import gsgen.sdk.b\nimport gsgen.sdk.c",
        B: "from gsgen.sdk import c",
        C: "import os",
    }
    assert measure("cycles", files).violations == []


def test_a_package_that_exports_its_modules_is_no_cycle(measure):
    package = "sdk/gsgen/sdk/__init__.py"
    files = {package: "from gsgen.sdk.a import f", A: "from gsgen.sdk import b", B: ""}
    assert measure("cycles", files).violations == []
    files[B] = "from gsgen.sdk import f"
    assert len(measure("cycles", files).violations) == 1


def test_a_module_that_imports_its_own_name_from_the_package_is_a_cycle(measure):
    package = "sdk/gsgen/sdk/__init__.py"
    files = {package: "from gsgen.sdk.a import f", A: "from gsgen.sdk import f"}
    assert len(measure("cycles", files).violations) == 1


def test_the_shortest_cycle_of_a_group_is_shown(measure):
    files = {
        A: "import gsgen.sdk.b",
        B: "import gsgen.sdk.c\nimport gsgen.sdk.a",
        C: "import gsgen.sdk.a",
    }
    (violation,) = measure("cycles", files).violations
    assert violation.actual.startswith("3 modules import each other")
    assert violation.actual.count(" imports ") == 2


@given(st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=30))
def test_components_are_the_modules_that_reach_each_other(edges):
    names = [str(number) for number in range(10)]
    graph = {name: {str(b): 0 for a, b in edges if str(a) == name and a != b} for name in names}
    reached = {name: {name} | set(graph[name]) for name in names}
    for _ in names:  # paths of at most ten steps
        reached = {
            name: {end for step in ends for end in reached[step]} for name, ends in reached.items()
        }
    groups = {tuple(sorted(b for b in reached[a] if a in reached[b])) for a in names}
    assert strong_components(graph) == sorted(list(group) for group in groups if len(group) > 1)
