"""Acme's own tests, which run where the package is installed from a wheel."""

import sys
from pathlib import Path

import pytest
from acme_gsgen import small_enough, write_row

from gsgen.conformance import GeneratorConformance, parametrize_with_rules
from gsgen.conformance.expected import ExpectedFailure
from gsgen.conformance.fixtures import example_model_of_rule, find
from gsgen.contract import validate

HERE = Path(__file__).parent


class TestRow(GeneratorConformance):
    """Three Gaussians keep the contract, and Acme's limit."""

    @pytest.fixture(scope="class")
    def model(self, tmp_path_factory: pytest.TempPathFactory) -> Path:
        path = tmp_path_factory.mktemp("row") / "row.onnx"
        write_row(path, 3)
        return path

    @pytest.fixture
    def target(self) -> str:
        return "acme"


def _long() -> list[Path]:
    write_row(HERE / "long.onnx", 5)
    return [HERE / "long.onnx"]


@parametrize_with_rules(
    _long,
    target="acme",
    suites=["basic"],
    expected_failures=[ExpectedFailure("acme/AC001", "Acme draws three.")],
)
def test_acme_rule_reports_long_rows(check):
    check()


def test_the_rule_s_example_breaks_it_and_no_other(tmp_path):
    fixture = find(example_model_of_rule(small_enough.id))
    report = validate(fixture.write(tmp_path), fixture.settings)
    assert {finding.rule for finding in report.findings} == {small_enough.id}


def test_acme_runs_without_torch():
    assert "torch" not in sys.modules
