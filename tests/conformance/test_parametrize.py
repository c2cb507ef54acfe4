"""`@parametrize_with_rules`: an author's own test, called once for each rule."""

from pathlib import Path

import pytest

from conformance.pytest_runs import run_pytest, write


def run(folder: Path, text: str, *words: str) -> "object":
    head = "from gsgen.conformance import parametrize_with_rules\n"
    (folder / "test_mine.py").write_text(head + text)
    return run_pytest(folder, *words)


def test_each_rule_of_each_model_is_a_test(folder: Path) -> None:
    write(folder, "drift", "opacity_is_logits")
    text = """
@parametrize_with_rules(["drift.onnx", "opacity_is_logits.onnx"], level="values", suites=["basic"])
def test_mine(check):
    assert check.model.is_file()
    check()
"""
    completed = run(folder, text)
    assert completed.code == 1, completed.out
    (failed,) = completed.names("failure")
    assert failed == "test_mine::test_mine[opacity_is_logits-basic-GV003-opacity-range]"
    assert "reproduce: gsgen repro opacity_is_logits.onnx --rule GV003" in completed.out
    assert completed.counts["passed"] > 60


def test_models_from_a_function_respect_options(folder: Path) -> None:
    write(folder, "drift")
    text = """
from pathlib import Path

def models():
    return Path(__file__).parent.glob("*.onnx")

@parametrize_with_rules(models, target="webgpu")
class TestMine:
    def test_mine(self, check):
        assert check.run.report.target.name == "webgpu"
        assert check.run.report.level.word == "static"
        check()
"""
    completed = run(folder, text, "--gsgen-level=static", "--gsgen-suite=time")
    assert completed.code == 0, completed.out
    assert "test_mine.TestMine::test_mine[drift-time-GI003-time-is-1]" in completed.cases
    assert all("[drift-time-" in name for name in completed.cases)


def test_a_test_that_forgets_to_check_fails(folder: Path) -> None:
    write(folder, "drift")
    text = """
@parametrize_with_rules(["drift.onnx"], level="static", suites=["time"])
def test_mine(check):
    pass
"""
    completed = run(folder, text)
    assert completed.code == 1
    assert "the test never called check()" in completed.out


def test_expected_failures_are_strict_both_ways(folder: Path) -> None:
    write(folder, "drift", "opacity_is_logits")
    text = """
from gsgen.conformance.expected import ExpectedFailure

@parametrize_with_rules(
    ["drift.onnx", "opacity_is_logits.onnx"],
    level="values",
    suites=["basic"],
    expected_failures=[ExpectedFailure("GV003", "logits until 2.0")],
)
def test_mine(check):
    check()
"""
    completed = run(folder, text, "-k", "GV003")
    assert completed.code == 1
    assert completed.names("failure") == ["test_mine::test_mine[drift-basic-GV003-opacity-range]"]
    assert "holds, but is expected to fail: remove the entry" in completed.out
    assert len(completed.names("xfailed")) == 1
    completed = run(folder, text.replace('2.0"', '2.0", "other*.onnx"'))
    assert completed.code == 2
    assert "matches no rule of any tested model" in completed.out


@pytest.mark.parametrize(
    ("arguments", "expected_message"),
    [
        ('["drift.onnx"], level="valeus"', "Did you mean 'values'?"),
        ('["drift.onnx"], suites=["tiem"]', "Did you mean 'time'?"),
        ('["missing.onnx"]', "missing.onnx"),
    ],
)
def test_decorator_mistake_is_reported_without_a_traceback(
    arguments: str, expected_message: str, folder: Path
) -> None:
    write(folder, "drift")
    completed = run(
        folder, f"@parametrize_with_rules({arguments})\ndef test_mine(check):\n    check()\n"
    )
    assert completed.code == 2, completed.out
    assert "test_mine.py::test_mine: gsgen: the model cannot be tested: " in completed.out
    assert expected_message in completed.out
    assert "another exception" not in completed.out
