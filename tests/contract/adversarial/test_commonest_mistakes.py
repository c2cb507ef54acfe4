"""Twenty-five mistakes of five families: each is named first, with a hint that mends."""

from pathlib import Path

import pytest

from contract.adversarial.commonest_mistakes import FAMILIES, MISTAKES, Mistake, write_model
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validator import validate

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("family", FAMILIES)
def test_the_model_that_follows_all_hints_conforms(family: str, tmp_path: Path) -> None:
    write_model(tmp_path / "a.onnx", family)
    report = validate(tmp_path / "a.onnx")
    assert [str(f.rule) for f in report.findings if f.severity > Severity.INFO] == []


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda m: f"{m.family}, {m.name}")
def test_each_mistake_is_named_first_with_its_repair(mistake: Mistake, tmp_path: Path) -> None:
    write_model(tmp_path / "a.onnx", mistake.family, mistake.name)
    first = validate(tmp_path / "a.onnx").findings[0]
    assert first.rule == mistake.rule
    assert mistake.words in f"{first.message} {first.hint}"
