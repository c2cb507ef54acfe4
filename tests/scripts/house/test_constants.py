"""Constants that several modules define."""

import pytest

LOW, HIGH = "contract/gsgen/contract/a.py", "runtime/gsgen/runtime/b.py"


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ("DILATION = 0.3", "_DILATION = 0.3"),
        ("_LARGEST_HALF = 65504.0", "HALF_LARGEST: float = 65504.0"),
        ("CONTROL_FLOW = {'If', 'Loop'}", "_CONTROL_FLOW = frozenset({'Loop', 'If'})"),
        ("MEBIBYTE = 1 << 20", "_MEBIBYTE = 1024 * 1024"),
        ("USAGE = 2", "_USAGE = 2"),
        ("PAIRS = ((0, 0), (0, 1))", "_UPPER_PAIRS = ((0, 0), (0, 1))"),
        ("_MOST_BYTES = 1900000000", "_MOST_BYTES = 1900000000"),
        ("C0 = 0.28209479177387814", "SH_C0 = 0.28209479177387814"),
    ],
)
def test_a_fact_with_two_homes_is_reported_where_it_is_repeated(measure, low, high):
    result = measure("constants", {LOW: low, HIGH: f"x = 1\n{high}"})
    assert [(v.path, v.line) for v in result.violations] == [(HIGH, 2)]
    assert not result.passed


@pytest.mark.parametrize(
    ("low", "high"),
    [
        ("DILATION = 0.3", "DILATION = 0.4"),
        ("DILATION = 0.3", "MARGIN = 0.3"),
        ("_MOST = 3", "_MOST = 3"),
        ("_CHUNK = 1 << 20", "_CHUNK = 1 << 20"),
        ("_RGB = 3", "_RGB_CHANNELS = 3"),
        ("_MOST_NODES = 64", "_MOST = 64"),
        ("name = 0.3", "name = 0.3"),
        ("SIZE = compute()", "SIZE = compute()"),
        ("AXES = ('x', 'y')", "AXES = ('y', 'x')"),
    ],
)
def test_coincidences_pass(measure, low, high):
    assert measure("constants", {LOW: low, HIGH: high}).violations == []


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("runtime/gsgen/runtime/b.py", "runtime/gsgen/runtime/a.py"),
        ("contract/gsgen/contract/b.py", "sdk/gsgen/sdk/a.py"),
        ("sdk/gsgen/sdk/b.py", "reference_plugins/gsgen/reference_plugins/a.py"),
    ],
)
def test_the_original_is_the_lowest_and_then_the_public_definition(measure, first, second):
    result = measure("constants", {first: "DILATION = 0.3", second: "_DILATION = 0.3"})
    (violation,) = result.violations
    assert violation.path == second
    assert f"repeats DILATION, {first}:1" in violation.actual


def test_tests_may_repeat_a_constant(measure):
    files = {LOW: "DILATION = 0.3", "tests/test_a.py": "DILATION = 0.3"}
    assert measure("constants", files).violations == []
