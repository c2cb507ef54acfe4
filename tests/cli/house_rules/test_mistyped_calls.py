"""Sixty mistyped calls: one message each, exit code 2 or 4, and a suggestion or what is known."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from support.commands import Ran, gsgen_here

# `good.onnx`, `bad.onnx` and `cloud.npz` exist, `tiles.json` and `notes.txt` are no such files.
CALLS = """
    vaildate good.onnx
    valid good.onnx
    check good.onnx
    exprot static cloud.npz -o out.onnx
    renderer cloud.npz -o out.png
    tile build cloud.npz -o tiles
    viewerkit write kit
    Validate good.onnx
    good.onnx
    validate
    validate goood.onnx
    validate good.onnx --levle static
    validate good.onnx --level statc
    validate good.onnx --level 2
    validate good.onnx --target webgup
    validate good.onnx --target
    validate good.onnx --fail-on err
    validate good.onnx --format jsn
    validate good.onnx --format
    validate good.onnx --ignore GV03
    validate good.onnx --ignore opacity-rang
    validate good.onnx --severity GV003
    validate good.onnx --severity GV003=fatal
    validate good.onnx --seed minus
    validate good.onnx --timeout 0
    validate good.onnx --memory lots
    validate good.onnx --jobs none
    validate cloud.npz
    validate notes.txt
    validate good.onnx -o report.onnx
    validate good.onnx --config none.toml
    inspect
    inspect notes.txt
    inspect good.onnx --emit-manifst
    explain GV0003
    explain opacity
    rules opasity
    repro good.onnx
    repro good.onnx --rule GV03
    diff good.onnx
    diff cloud.npz good.onnx
    export
    export statik cloud.npz -o out.onnx
    export static -o out.onnx
    export static cloud.npz
    export static cloud.xyz -o out.onnx
    export static cloud.npz -o out.ply
    export static cloud.npz -o out.onnx --dtype float8
    export static cloud.npz -o out.onnx --levle static
    export module:nothing -o out.onnx
    convert cloud.npz
    convert cloud.npz out.plx
    convert out.ply cloud.npz
    convert cloud.npz out.ply --sh-degre 1
    render cloud.npz
    render cloud.npz -o out.jpgg
    render cloud.npz -o out.png --camera orbits
    render cloud.npz -o out.png --width wide
    render cloud.npz -o out.png --rasteriser tyles
    render nowhere.ply -o out.png
    view nowhere.ply
    bake good.onnx -o out.xyz
    bench good.onnx --provider gpx
    rewrite good.onnx
    rewrite good.onnx --dry-run --target webgl
    rewrite good.onnx --dry-run --pass SplitWideConact
    fix good.onnx
    float16 good.onnx -o cloud.npz --budget few
    new My Method
    new 1method
    conformance good.onnx --suite camra
    vectors good.onnx --count none
    references good.onnx
    tiles buld cloud.npz -o tiles
    tiles info tiles.json
    tiles build cloud.npz -o tiles --engine process
    plugins --jsn
    doctor --jsonn
"""
LINES = [line.strip() for line in CALLS.strip().splitlines()]
# Words that offer a way on: a near name, the list of known ones, or what to type.
SUGGESTION_PATTERN = re.compile(
    r"Did you mean|Known:|are known, such as|[Ee]xpected|Name |Give |Type |`gsgen |is not one of|"
    r"Possible options|[Mm]issing (option|argument)|is not in the range|Write it as|such as|"
    r"Change the suffix|For example|gsgen render"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("mistyped")
    find("still_rgb").write(folder).rename(folder / "good.onnx")
    find("opacity_is_logits").write(folder).rename(folder / "bad.onnx")
    rows = np.zeros((20, 10), np.float32)
    rows[:, 3], rows[:, [4, 7, 9]] = 0.8, 0.02
    np.savez(folder / "cloud.npz", gaussians=rows, appearance=np.full((20, 3), 0.5, np.float32))
    (folder / "notes.txt").write_text("Notes.\n", "utf-8")
    (folder / "tiles.json").write_text("[]", "utf-8")
    return folder


@pytest.fixture(scope="module")
def answers(folder: Path) -> dict[str, Ran]:
    return {line: gsgen_here(*shlex.split(line), cwd=folder) for line in LINES}


@pytest.mark.parametrize("line", LINES)
def test_a_mistyped_call_ends_in_one_message(line: str, answers: dict[str, Ran]) -> None:
    completed = answers[line]
    assert completed.code in (2, 4), completed
    assert (
        completed.out == "" or "export [OPTIONS] TARGET" in completed.out
    )  # a group alone prints its help
    assert "Traceback" not in completed.err
    assert "internal error" not in completed.err
    messages = completed.err.count("gsgen: ") + completed.err.count("─ Error ─")
    assert messages == (0 if completed.out else 1), completed.err


def test_nine_of_ten_messages_suggest_a_fix(answers: dict[str, Ran]) -> None:
    unhelpful_lines = [
        line
        for line, completed in answers.items()
        if not SUGGESTION_PATTERN.search(completed.err + completed.out)
    ]
    assert len(answers) >= 60
    assert len(unhelpful_lines) <= len(answers) // 10, unhelpful_lines


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("render cloud.npz", "`gsgen render cloud.npz -o cloud.png`"),
        ("render cloud.npz --fov 40", "`gsgen render cloud.npz --fov 40 -o cloud.png`"),
        ("render cloud.npz film.mp4", "`gsgen render cloud.npz -o film.mp4`"),
        ("render good.onnx cloud.npz", "`gsgen render good.onnx cloud.npz -o good.png`"),
        ("bake good.onnx", "`gsgen bake good.onnx -o good.ply`"),
        ("export cloud.npz -o page.html", "`gsgen export html cloud.npz -o page.html`"),
        ("export good.onnx -o page.html", "`gsgen export html good.onnx -o page.html`"),
    ],
)
def test_the_call_that_was_meant_is_printed(folder: Path, line: str, hint: str) -> None:
    completed = gsgen_here(*shlex.split(line), cwd=folder)
    assert completed.code == 2
    assert hint in completed.err


def test_no_mistyped_call_writes_a_file(folder: Path, answers: dict[str, Ran]) -> None:
    assert {path.name for path in folder.iterdir()} == {
        "good.onnx", "bad.onnx", "cloud.npz", "notes.txt", "tiles.json",
    }  # fmt: skip
