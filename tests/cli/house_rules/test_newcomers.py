"""What people type who have not read everything: nothing is lost, and each word says what to do."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gsgen.cli.command_table import PANELS
from gsgen.conformance.fixtures import find
from support.commands import gsgen, gsgen_here


@pytest.fixture
def logits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    find("opacity_is_logits").write(tmp_path)
    return Path("opacity_is_logits.onnx")


@pytest.mark.parametrize(
    "words",
    [
        ("validate", "MODEL", "-o", "MODEL"),
        ("validate", "MODEL", "--json", "-o", "link.txt"),
        ("bench", "MODEL", "-o", "MODEL"),
        ("repro", "MODEL", "--rule", "GV003", "--dump", "MODEL"),
        ("export", "static", "splats.ply", "-o", "splats.ply"),
        ("export", "static", "splats.ply", "-o", "new.onnx", "--report", "MODEL"),
    ],
    ids=" ".join,
)
def test_outputs_do_not_overwrite_inputs(logits: Path, words: tuple[str, ...]) -> None:
    Path("link.txt").symlink_to(logits)
    head = "ply\nformat ascii 1.0\nelement vertex 1\n"
    names = ("x", "y", "z", "red", "green", "blue")
    head += "".join(f"property float {name}\n" for name in names)
    Path("splats.ply").write_text(f"{head}end_header\n0 0 0 1 1 1\n", encoding="utf-8")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    completed = gsgen_here(*(str(logits) if word == "MODEL" else word for word in words))
    assert completed.code == 2
    assert "would be overwritten" in completed.err or "the output is not a model" in completed.err
    assert {path: path.read_bytes() for path in Path().iterdir()} == before


def test_report_does_not_overwrite_a_model(logits: Path) -> None:
    completed = gsgen_here("validate", logits, "-o", "copy.onnx")
    assert completed.code == 2
    assert completed.err == (
        "gsgen: copy.onnx: ends in .onnx, but the output is not a model\n"
        "  Name another file, such as copy.txt.\n"
    )


def test_a_file_is_no_folder_for_dumps(logits: Path) -> None:
    completed = gsgen_here("conformance", logits, "--dump", logits)
    assert (completed.code, completed.err) == (
        2,
        f"gsgen: {logits}: is a file, expected a folder\n",
    )


@pytest.mark.parametrize("command", ["validate", "conformance"])
def test_json_is_an_option_of_every_command_that_reports(command: str, logits: Path) -> None:
    short_json = gsgen_here(command, logits, "--level", "static", "--json")
    long = gsgen_here(command, logits, "--level", "static", "--format", "json")
    assert short_json.code == long.code == 0
    assert json.loads(short_json.out).keys() == json.loads(long.out).keys()


def test_numbers_are_numbers_in_json(logits: Path, good: Path) -> None:
    completed = gsgen_here("diff", good, good, "--json")
    assert {entry["largest"] for entry in json.loads(completed.out)["outputs"]} == {0.0}


def test_a_model_without_inputs_has_one_vector(logits: Path) -> None:
    completed = gsgen_here("vectors", logits, "--count", "2")
    assert (
        completed.code,
        "2 test vectors, but the model has only 1 probe\n" in completed.err,
    ) == (2, True)
    model = find("still_rgb").write(Path())
    assert gsgen_here("vectors", model).code == 0
    assert [path.name for path in Path("still_rgb-vectors").glob("test*")] == ["test_data_set_0"]


def test_several_rules_are_explained() -> None:
    completed = gsgen_here("explain", "GV003", "rows-finite")
    assert completed.out.count("\n## How to repair it") == 2


@pytest.mark.parametrize("words", [("help",), ("help", "validate")])
def test_help_command_prints_help(words: tuple[str, ...]) -> None:
    completed = gsgen_here(*words)
    assert completed.code == 0
    assert f"gsgen {' '.join(words[1:])}".strip() in completed.out


def test_every_command_is_listed_once_in_its_panel() -> None:
    panels: dict[str, list[str]] = {}
    for line in gsgen_here("--help", env={"COLUMNS": "80"}).out.splitlines():
        assert len(line) <= 80
        if line.startswith("╭─ "):
            panel = panels.setdefault(line.strip("╭─╮ "), [])
        elif line.startswith("│ ") and line[2] not in " -":
            panel.append(line.split()[1])
    del panels["Options"]
    assert panels == {title: [entry.name for entry in panel] for title, panel in PANELS.items()}


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("gsgen vali", ["validate"]),
        ("gsgen validate --lev", ["--level"]),
        ("gsgen export scaf", ["scaffold-gs"]),
    ],
)
def test_a_shell_completes_commands_and_options(words: str, expected: list[str]) -> None:
    env = {"_GSGEN_COMPLETE": "complete_bash", "COMP_WORDS": words}
    env |= {"COMP_CWORD": str(words.count(" "))}
    program = Path(sys.executable).with_name("gsgen")  # the variable is named after the program
    completed = subprocess.run(
        program, env=os.environ | env, capture_output=True, text=True, timeout=60
    )
    assert (completed.returncode, completed.stdout.split()) == (0, expected), completed.stderr


@pytest.mark.parametrize(
    ("name", "command"), [("garden.ply", "gsgen render"), ("drift.onnx", "gsgen validate")]
)
def test_a_file_in_place_of_a_command_gets_a_command_for_it(
    name: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).touch()
    assert f"`{command} {name}" in gsgen_here(name).err


def test_a_missing_splat_file_gets_the_nearest_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "garden.ply").touch()
    for words in (("convert", "gardn.ply", "x.spz"), ("render", "gardn.ply", "-o", "x.png")):
        completed = gsgen_here(*words)
        assert completed.code == 4
        assert completed.err.count("Did you mean 'garden.ply'?") == 1, completed.err


def test_python_m_gsgen_is_gsgen() -> None:
    words = [sys.executable, "-m", "gsgen", "--version"]
    completed = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert (completed.returncode, completed.stdout) == (0, gsgen("--version").out)


@pytest.mark.parametrize(
    ("content", "visited_cameras"),
    [
        (b"# Models\n\nare \xc3\xa4 here\n", "text"),
        (b"\x10\x00\x00\x00\x00\x00\x00\x00{}        ", "a file of weights (safetensors)"),
        (b"glTF\x02\x00\x00\x00", "a GLB file without splats"),
        (b"\x80\x05\x95\x00\x00", "a pickle"),
    ],
)
def test_a_file_of_another_kind_is_named(
    content: bytes, visited_cameras: str, tmp_path: Path
) -> None:
    path = tmp_path / "some.onnx"
    path.write_bytes(content)
    completed = gsgen_here("validate", path)
    assert completed.code == 4
    assert f"some.onnx: is not an ONNX model but {visited_cameras}" in completed.err


def test_mistyped_rule_suggests_the_nearest_rule(logits: Path) -> None:
    completed = gsgen_here("validate", logits, "--severity", "GV003")
    assert "Write it as GV003=error." in completed.err


def test_a_dry_run_may_be_added_to_any_command_line(good: Path, tmp_path: Path) -> None:
    for command in ("rewrite", "fix", "float16"):
        alone = gsgen_here(command, good)
        assert (alone.code, "Give -o OUT.onnx, or --dry-run" in alone.err) == (2, True)
    out = tmp_path / "out.onnx"
    assert gsgen_here("rewrite", good, "-o", out, "--dry-run").code == 0
    assert not out.exists()


def test_folder_of_models_lists_its_models(logits: Path) -> None:
    completed = gsgen_here("inspect", Path())
    assert (completed.code, completed.err) == (
        4,
        "gsgen: .: is a folder, expected an ONNX file\n"
        "  It holds 1: name opacity_is_logits.onnx, or ./*.onnx.\n",
    )


def test_a_folder_of_models_is_validated(logits: Path) -> None:
    alone, folder = gsgen_here("validate", logits), gsgen_here("validate", Path())
    assert (folder.code, folder.err) == (alone.code, "")
    assert "opacity_is_logits.onnx" in folder.out


def test_setting_outside_its_table_names_the_table(logits: Path) -> None:
    Path("gsgen.toml").write_text('target = "webgpu"\n', encoding="utf-8")
    completed = gsgen_here("validate", logits)
    assert completed.err == "gsgen: gsgen.toml: unknown key 'target'\n  Put it under [validate].\n"


def test_suggested_commands_can_be_pasted(logits: Path, tmp_path: Path) -> None:
    folder = tmp_path / "my models"
    folder.mkdir()
    model = find("still_rgb").write(folder)
    completed = gsgen_here("vectors", model, cwd=tmp_path)
    assert f"`gsgen validate '{folder}/still_rgb-vectors/model.onnx'` runs them" in completed.out
    unlabelled = find("no_manifest").write(folder)
    assert (
        f"`gsgen inspect '{unlabelled}' --emit-manifest`" in gsgen_here("vectors", unlabelled).err
    )


def test_rules_are_found_by_family_and_word() -> None:
    all_entries = gsgen_here("rules").out
    cells = json.loads(gsgen_here("rules", "GV03", "cells", "--json").out)
    assert {"GV030", "GV031", "GO020"} <= {entry["id"] for entry in cells}
    assert all(
        entry["id"].startswith("GV03") or "cells" in f"{entry['slug']} {entry['statement']}".lower()
        for entry in cells
    )
    assert len(gsgen_here("rules", "gv").out) < len(all_entries) / 2
    completed = gsgen_here("rules", "opacty-range")
    assert (completed.code, "Did you mean 'opacity-range'?" in completed.err) == (2, True)
