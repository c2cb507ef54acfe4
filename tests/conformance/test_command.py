"""`gsgen conformance`: the same suites without pytest."""

import json
import shlex
import subprocess
import sys
from pathlib import Path

from conformance.pytest_runs import write
from support.commands import gsgen_here


def test_each_suite_is_one_line_and_failures_say_how_to_see_them_again(folder: Path) -> None:
    write(folder, "drift", "opacity_is_logits")
    completed = gsgen_here(
        *(
            "conformance",
            "drift.onnx",
            "opacity_is_logits.onnx",
            "--level",
            "values",
            "--dump",
            "dumps",
        ),
        cwd=folder,
    )
    assert completed.code == 1, completed.err
    lines = completed.out.splitlines()
    good, broken = [i for i, line in enumerate(lines) if "validated for core@" in line]
    suites = [line.split()[0] for line in lines[good + 1 : broken - 1]]
    assert suites == ["basic", "time", "appearance", "capture"]
    assert lines[broken - 1].startswith("passed: ")
    assert lines[-1].startswith("failed: ")
    assert "  basic: GV003-opacity-range failed" in lines
    (line,) = [line for line in lines if "reproduce: " in line]
    words = shlex.split(line.partition("reproduce: ")[2])
    assert gsgen_here(*words[1:], cwd=folder).code == 1
    assert (folder / "dumps" / "opacity_is_logits.core.GV003.npz").is_file()


def test_json_lists_every_case(folder: Path) -> None:
    (model,) = write(folder, "drift")
    completed = gsgen_here("conformance", model, "--format", "json", "--level", "static")
    assert completed.code == 0
    document = json.loads(completed.out)
    assert document["schema"] == "gsgen-conformance/1"
    (result,) = document["models"]
    cases = [case for suite in result["suites"] for case in suite["cases"]]
    assert result["verdict"] == "passed"
    assert sum(result["counts"].values()) == len(cases)
    skipped = next(case for case in cases if case["rule"] == "GV003")
    assert skipped["status"] == "skipped"
    assert skipped["reason"] == "skipped: level values was not requested"


def test_pytest_need_not_be_installed(folder: Path) -> None:
    (model,) = write(folder, "drift")
    script = (
        "import sys; sys.modules['pytest'] = None; from gsgen.cli import main; "
        f"sys.argv[1:] = ['conformance', {str(model)!r}, '--level', 'static']; main()"
    )
    completed = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert completed.returncode == 0, completed.stderr
    assert "passed: " in completed.stdout


def test_single_suite_can_be_selected(folder: Path) -> None:
    (model,) = write(folder, "drift")
    completed = gsgen_here("conformance", model, "--suite", "time", "--level", "static")
    assert completed.code == 0
    assert "  time " in completed.out
    assert "  basic " not in completed.out


def test_a_suite_that_applies_to_no_model_does_not_pass(folder: Path) -> None:
    (model,) = write(folder, "drift")
    completed = gsgen_here("conformance", model, "--suite", "camera", "--level", "static")
    assert completed.code == 2
    assert "the suite 'camera' applies to no tested model" in completed.err
    assert "Those that apply: basic, time" in completed.err


def test_a_folder_and_a_glob_name_their_models(folder: Path) -> None:
    write(folder, "drift", "still_rgb")
    for name in (folder, folder / "*.onnx"):
        completed = gsgen_here("conformance", name, "--level", "static")
        assert completed.code == 0
        assert "drift.onnx" in completed.out
        assert "still_rgb.onnx" in completed.out


def test_exit_codes_are_those_of_validate(folder: Path) -> None:
    (model,) = write(folder, "drift")
    empty = folder / "empty.onnx"
    empty.touch()
    completed = gsgen_here("conformance", empty, model, "--level", "static")
    assert completed.code == 4
    assert "is empty (0 bytes)" in completed.err
    assert "passed: " in completed.out
    wrong = gsgen_here("conformance", model, "--suite", "tme")
    assert wrong.code == 2
    assert "Did you mean 'time'?" in wrong.err
