"""`pytest --gsgen model.onnx`: one test a rule, without a file of the author's."""

import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from conformance.pytest_runs import run_pytest, write


def reproduce(line: str, folder: Path) -> "subprocess.CompletedProcess[str]":
    """Type the line that a failure printed."""
    words = shlex.split(line)
    assert words[0] == "gsgen"
    command = [sys.executable, "-m", "gsgen.cli", *words[1:]]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder)


def lines_with(text: str, words: str) -> list[str]:
    actual = [line.partition(words)[2].strip() for line in text.splitlines()]
    return [line for line in actual if line]


def test_a_good_model_passes_and_only_the_model_is_collected(folder: Path) -> None:
    write(folder, "drift")
    (folder / "test_other.py").write_text("def test_other():\n    assert False\n")
    completed = run_pytest(folder, "--gsgen", "drift.onnx", "-k", "not live")
    assert completed.code == 0, completed.out
    assert set(completed.counts) <= {"passed", "skipped"}
    assert completed.counts["passed"] > 40
    suites = {name.partition("::")[0] for name in completed.cases}
    assert suites == {f"drift.onnx.{s}" for s in ("basic", "time", "appearance", "capture")}


def test_tests_that_are_named_run_beside_the_model(folder: Path) -> None:
    write(folder, "drift", "avatar")
    (folder / "test_mine.py").write_text("def test_mine():\n    pass\n")
    options = ("--gsgen", "drift.onnx", "--gsgen-level", "static", "--gsgen-suite", "basic")
    completed = run_pytest(folder, *options, "test_mine.py", "avatar.onnx")
    assert completed.code == 0, completed.out
    assert {name.partition(".")[0].partition("::")[0] for name in completed.cases} == {
        *("drift", "avatar", "test_mine")
    }


def test_without_the_option_models_are_left_alone(folder: Path) -> None:
    write(folder, "drift")
    (folder / "test_mine.py").write_text("def test_mine():\n    pass\n")
    completed = run_pytest(folder)
    assert list(completed.cases) == ["test_mine::test_mine"]


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("opacity_is_logits", "GV003"),
        ("dropout_by_a_flag", "GB001"),
        ("view_flattened", "GI001"),
        ("nan_at_zero_inputs", "GI009"),
        ("fails_at_end_of_time", "GV025"),
    ],
)
def test_a_broken_model_fails_with_its_rule_and_a_line_that_shows_it_again(
    folder: Path, name: str, rule: str
) -> None:
    write(folder, name)
    level = "behaviour" if rule == "GB001" else "values"
    options = ("--gsgen-dump=dumps", f"--gsgen-level={level}")
    completed = run_pytest(folder, f"--gsgen={name}.onnx", *options)
    assert completed.code == 1, completed.out
    (failed,) = completed.names("failure")
    assert failed.partition("::")[2].startswith(f"{rule}-")
    assert f"{rule} error" in completed.out
    (line,) = set(lines_with(completed.out, "reproduce: "))
    again = reproduce(line, folder)
    assert again.returncode == 1, again.stdout + again.stderr
    assert f"reproduced: {rule} is broken" in again.stdout
    dumps = set(lines_with(completed.out, "inputs and outputs: "))
    assert len(dumps) == (0 if rule == "GI001" else 1)


def test_a_folder_names_all_models_in_it(folder: Path) -> None:
    write(folder, "drift", "still_rgb")
    completed = run_pytest(folder, f"--gsgen={folder}", "--gsgen-level=static", "-k", "GM001", "-v")
    assert completed.code == 0, completed.out
    assert "2 passed" in completed.out
    assert run_pytest(folder, "--gsgen=none*.onnx").code == pytest.ExitCode.USAGE_ERROR


def test_the_dump_holds_what_went_in_and_what_came_out(folder: Path) -> None:
    write(folder, "drift")
    import onnx

    model = onnx.load(folder / "drift.onnx")
    for weight in model.graph.initializer:
        if weight.dims and weight.dims[-1] == 3:
            array = onnx.numpy_helper.to_array(weight).copy()
            array[1] = np.nan
            weight.CopyFrom(onnx.numpy_helper.from_array(array, weight.name))
            break
    onnx.save(model, folder / "nan.onnx")
    completed = run_pytest(folder, "--gsgen=nan.onnx", "--gsgen-level=values", "-k", "GV001")
    assert completed.code == 1, completed.out
    (dump,) = set(lines_with(completed.out, "inputs and outputs: "))
    with np.load(dump) as arrays:
        assert arrays["probe"].item().startswith("time=")
        assert arrays["input.time"].shape == (1,)
        outputs = [arrays[name] for name in arrays if name.startswith("output.")]
        assert len(outputs) == 3
        assert any(np.isnan(array).any() for array in outputs)
    (line,) = set(lines_with(completed.out, "reproduce: "))
    assert "--probe time=" in line
    assert reproduce(line, folder).returncode == 1


def test_unchecked_rule_is_skipped_with_the_reason(folder: Path) -> None:
    write(folder, "drift")
    completed = run_pytest(folder, "--gsgen=drift.onnx", "--gsgen-level=static")
    assert completed.code == 0
    assert "skipped: level values was not requested" in completed.out


def test_warnings_warn_or_fail_as_asked(folder: Path) -> None:
    write(folder, "all_transparent")
    options = ("--gsgen=all_transparent.onnx", "--gsgen-level=values", "-k", "GV004")
    completed = run_pytest(folder, *options)
    assert completed.code == 0
    assert "RuleWarning: GV004 warning mostly-visible" in completed.out
    completed = run_pytest(folder, *options, "--gsgen-fail-on=warning")
    assert completed.code == 1


def test_the_target_brings_its_rules(folder: Path) -> None:
    write(folder, "still_sh1")
    options = ("--gsgen-target=visionary", "--gsgen-level=static")
    completed = run_pytest(folder, "--gsgen=still_sh1.onnx", *options)
    assert completed.code == 1
    (failed,) = completed.names("failure")
    assert failed == "still_sh1.onnx.appearance::TV104-visionary-reads-color"
    assert "--target visionary" in completed.out


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (("--gsgen=none.onnx",), 4, "none.onnx"),
        (("--gsgen=text.onnx",), 2, "is not an ONNX model but text"),
        (("--gsgen=drift.onnx", "--gsgen-suite=tme"), 4, "Did you mean 'time'?"),
        (
            ("--gsgen=drift.onnx", "--gsgen-xfails=none.toml"),
            4,
            "none.toml: the file of expected failures cannot be read",
        ),
    ],
)
def test_a_wrong_option_ends_the_run_and_names_itself(
    folder: Path, options: tuple[str, ...], code: int, words: str
) -> None:
    write(folder, "drift")
    (folder / "text.onnx").write_text("this is no model\n")
    completed = run_pytest(folder, *options)
    assert completed.code == code, completed.out
    assert words in completed.out
    assert "INTERNALERROR" not in completed.out


def test_a_crashed_rule_is_an_error_not_a_failure(folder: Path) -> None:
    write(folder, "drift")
    (folder / "conftest.py").write_text(CRASHING)
    completed = run_pytest(folder, "--gsgen=drift.onnx", "--gsgen-level=static")
    assert completed.code == 1
    assert completed.names("error") == ["drift.onnx.basic::acme/AC001-never-works"]
    assert "acme/AC001 crashed: this is a fault of the rule" in completed.out
    assert "ZeroDivisionError" in completed.out


CRASHING = """
from dataclasses import replace
from gsgen.contract.rules import catalogue as installed

own = installed.builtin_rules

def builtin_rules():
    def crash(subject):
        yield 1 / 0

    return [*own(), replace(own()[0], id="acme/AC001", slug="never-works", check=crash)]

installed.builtin_rules = builtin_rules
"""


def test_workers_share_the_tests(folder: Path) -> None:
    write(folder, "drift", "opacity_is_logits")
    options = ("--gsgen=drift.onnx", "--gsgen=opacity_is_logits.onnx", "--gsgen-level=values")
    completed = run_pytest(folder, *options, "-p", "xdist.plugin", "-n2", "--gsgen-suite=basic")
    assert completed.code == 1, completed.out
    assert len(completed.names("failure")) == 1
    assert completed.counts["passed"] > 60
