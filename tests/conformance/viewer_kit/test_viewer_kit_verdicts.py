"""Verdicts of the viewer kit: the limit that failed, the suspected faults, and damaged kits."""

import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.conformance.viewer_kit.check_viewer import (
    check_viewer,
    compare,
    page_of,
    summary_of,
    suspected_faults,
)
from gsgen.conformance.viewer_kit.picture_files import encode_png
from gsgen.conformance.viewer_kit.write import TOLERANCE, kit_cases, write_kit
from gsgen.contract.errors import ConfigInvalid
from gsgen.runtime.checks.viewer_kit import draw_frames
from support.commands import Ran, gsgen_here

TOTAL = sum(len(case.frames) for case in kit_cases())
ROUNDINGS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "nearest": lambda picture: np.rint(picture * 255),
    "down": lambda picture: np.floor(picture * 255),
    "of-256": lambda picture: np.minimum(np.floor(picture * 256), 255),
}


@pytest.fixture(scope="module")
def kit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_kit(tmp_path_factory.mktemp("kit") / "kit", draw_frames).parent


@pytest.fixture
def pictures(kit: Path, tmp_path: Path) -> Path:
    """The right pictures, to change."""
    return Path(shutil.copytree(kit / "expected", tmp_path / "pictures"))


def _script(kit: Path, *words: str | Path, cwd: Path) -> Ran:
    command = [sys.executable, str(kit / "check_viewer.py"), *map(str, words)]
    completed = subprocess.run(
        command, capture_output=True, encoding="utf-8", cwd=cwd, env={"PYTHONUTF8": "1"}
    )
    return Ran(completed.returncode, completed.stdout, completed.stderr)


@pytest.mark.parametrize("rounding", ROUNDINGS)
def test_right_pictures_of_8_bits_pass_in_every_rounding(
    rounding: str, kit: Path, tmp_path: Path
) -> None:
    for path in (kit / "expected").glob("*.npy"):
        rounded = ROUNDINGS[rounding](np.load(path).astype(np.float64)) / 255
        (tmp_path / f"{path.stem}.png").write_bytes(encode_png(rounded))
    result = check_viewer(kit, tmp_path)
    assert result["counts"]["failed"] == 0
    # There is room left: rounding takes at most four fifths of each limit.
    limits = result["tolerance_8_bits"]
    frames = [frame for case in result["cases"] for frame in case["frames"]]
    assert max(frame["mean"] for frame in frames) <= 0.8 * limits["mean"]
    assert max(frame["max"] for frame in frames) <= 0.8 * limits["pixel"]


def test_the_reason_is_the_limit_that_failed() -> None:
    right = np.full((20, 20, 3), 0.5)
    (entry,) = compare(right, right + 0.00197, TOLERANCE)["exceeded"]
    assert entry["message"] == "mean difference 0.00197, expected at most 0.001"
    assert (entry["limit"], entry["expected"]) == ("mean", 0.001)
    assert entry["actual"] == pytest.approx(0.00197)
    (just_failing,) = compare(right, right + 0.00100001, TOLERANCE)["exceeded"]
    assert just_failing["message"] == "mean difference 0.00100001, expected at most 0.001"
    spotted = right.copy()
    spotted[0, :3, 1] += 0.1
    (entry,) = compare(right, spotted, TOLERANCE)["exceeded"]
    assert entry["message"] == (
        "0.75 % of the pixels differ by more than 0.02, expected at most 0.5 %"
    )


def test_text_and_page_name_the_limit(kit: Path, pictures: Path) -> None:
    np.save(pictures / "rgb-0.npy", np.load(pictures / "rgb-0.npy") + 0.00197)
    result = check_viewer(kit, pictures)
    (line, *_) = summary_of(result).splitlines()
    assert line.startswith("failed: rgb: rgb-0: mean difference 0.00")
    assert line.endswith(", expected at most 0.001")
    assert line.removeprefix("failed: rgb: ") in page_of(kit, pictures, result)


def test_a_fault_that_explains_too_little_is_not_suspected(kit: Path, pictures: Path) -> None:
    for name in ("rgb-four-channels-0", "linear-color-0", "viewport-0", "pose-1", "control-0"):
        np.save(pictures / f"{name}.npy", 1 - np.load(pictures / f"{name}.npy"))
    result = check_viewer(kit, pictures)
    assert result["faults"] == []
    assert "no known fault explains these failures" in summary_of(result)
    assert "no known fault explains these failures." in page_of(kit, pictures, result)


def test_a_fault_needs_four_fifths_of_the_failures() -> None:
    index = {"faults": [{"id": "a", "cases": ["1", "2", "3", "4"]}, {"id": "b", "cases": ["5"]}]}
    ids = [
        [fault["id"] for fault in suspected_faults(index, set(failed))]
        for failed in ("1234", "12346", "123467", "123", "12345", "5", "6")
    ]
    assert ids == [["a"], ["a"], [], [], ["a"], ["b"], []]


def test_two_faults_that_explain_all_together_are_suspected() -> None:
    cases = {"a": ["1", "5"], "b": ["2", "6"], "c": ["3", "2"], "d": ["4"], "e": ["7"]}
    index = {"faults": [{"id": name, "cases": names} for name, names in cases.items()]}
    suspected = [
        [fault["id"] for fault in suspected_faults(index, set(failed))]
        for failed in ("1526", "1523", "15236", "154", "47")
    ]
    assert suspected == [["a", "b"], ["a", "c"], [], [], []]


def test_a_slightly_spoiled_case_may_pass_or_fail() -> None:
    index = {"faults": [{"id": "a", "cases": ["1", "2"], "slight": ["3", "4"]}]}
    for failed in ("12", "123", "1234"):
        assert suspected_faults(index, set(failed)) == index["faults"]
    for failed in ("1", "34", "1256"):
        assert suspected_faults(index, set(failed)) == []


def test_missing_pictures_are_counted_and_not_diagnosed(kit: Path, tmp_path: Path) -> None:
    result = check_viewer(kit, tmp_path)
    assert result["pictures"] == {"total": TOTAL, "missing": TOTAL, "unreadable": 0}
    assert (result["verdict"], result["faults"]) == ("failed", [])
    text = summary_of(result)
    assert f"{TOTAL} of {TOTAL} pictures are missing" in text
    assert "suspected" not in text
    assert "no known fault" not in text
    assert f"{TOTAL} of {TOTAL} pictures are missing" in page_of(kit, tmp_path, result)


def test_pictures_of_another_size_are_counted_and_not_diagnosed(kit: Path, pictures: Path) -> None:
    for path in pictures.iterdir():
        np.save(path, np.zeros((4, 4, 3), np.float32))
    result = check_viewer(kit, pictures)
    assert result["pictures"] == {"total": TOTAL, "missing": 0, "unreadable": TOTAL}
    assert result["faults"] == []
    assert f"{TOTAL} of {TOTAL} pictures cannot be read" in summary_of(result)


def test_a_fault_is_found_although_a_picture_is_missing(kit: Path, pictures: Path) -> None:
    for path in pictures.iterdir():
        np.save(path, 1 - np.load(path))
    (pictures / "rgb-0.npy").unlink()
    result = check_viewer(kit, pictures)
    assert [fault["id"] for fault in result["faults"]] == ["rows"]
    assert f"1 of {TOTAL} pictures is missing" in summary_of(result)


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda _: {"schema": "gsgen-viewer-kit/1"}, "the index: tolerance is missing"),
        (lambda _: [1], "the schema is None, expected 'gsgen-viewer-kit/1'"),
        (lambda d: d | {"cases": []}, "cases is empty, expected at least one"),
        (lambda d: d | {"cases": [1]}, "cases[0] is a int, expected an object"),
        (lambda d: d | {"faults": {}}, "the index: faults is {}, expected a list"),
        (lambda d: d | {"tolerance": {"pixel": "x"}}, "tolerance: pixel is 'x', expected a number"),
        (lambda d: d["cases"][2].pop("frames") and d, "cases[2]: frames is missing"),
        (lambda d: d["cases"][0].update(frames=[]) or d, "cases[0]: frames is empty"),
        (lambda d: d["cases"][1]["frames"][0].pop("picture") and d, "cases[1].frames[0]: picture"),
        (lambda d: d["faults"][0].update(cases=[[]]) or d, "faults[0]: cases is [[]]"),
    ],
)
def test_a_damaged_index_is_an_unreadable_kit(
    edit: Callable[[Any], Any], words: str, kit: Path, tmp_path: Path
) -> None:
    damaged = tmp_path / "kit"
    damaged.mkdir()
    document = edit(json.loads((kit / "index.json").read_text("utf-8")))
    (damaged / "index.json").write_text(json.dumps(document), "utf-8")
    completed = gsgen_here("viewer-kit", "check", "kit", "kit/..", cwd=tmp_path)
    assert (completed.code, completed.out) == (4, "")
    assert words in completed.err
    assert "internal error" not in completed.err


def test_the_script_ends_with_the_codes_of_the_command(
    kit: Path, pictures: Path, tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    for kit_folder, folder, code, words in (
        (kit, pictures, 0, ""),
        (kit, "empty", 1, ""),
        (kit, "nowhere", 4, "nowhere: is not a folder, expected that of the viewer's pictures"),
        ("nowhere", pictures, 4, "nowhere: is not a folder, expected the folder of a viewer test"),
        ("empty", pictures, 4, "`gsgen viewer-kit write FOLDER` writes a kit"),
        (pictures, kit, 4, f"{kit} holds an index.json: the two folders may be swapped"),
    ):
        command = gsgen_here("viewer-kit", "check", kit_folder, folder, cwd=tmp_path)
        script = _script(kit, folder, "--kit", kit_folder, cwd=tmp_path)
        assert (command.code, script.code) == (code, code)
        assert command.out == script.out
        for completed in (command, script):
            assert words in " ".join(completed.err.split())
            assert "Errno" not in completed.err
            assert "Traceback" not in completed.err


def test_the_verdict_is_printed_although_the_page_cannot_be_written(
    kit: Path, pictures: Path, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    page = ("--html", "file/page.html")
    command = gsgen_here("viewer-kit", "check", kit, pictures, *page, cwd=tmp_path)
    script = _script(kit, pictures, *page, cwd=tmp_path)
    for completed in (command, script):
        assert completed.code == 2
        assert completed.out == f"passed: {len(kit_cases())} passed, 0 failed\n"
        assert "page.html" in completed.err or "file" in completed.err
        assert "Traceback" not in completed.err


def test_the_script_makes_the_folder_of_its_page(kit: Path, pictures: Path, tmp_path: Path) -> None:
    completed = _script(
        kit, pictures, "--html", "new/page.html", "--json", "new/r.json", cwd=tmp_path
    )
    assert (completed.code, completed.err) == (0, "")
    assert {path.name for path in (tmp_path / "new").iterdir()} == {"page.html", "r.json"}


def test_a_file_in_the_place_of_the_kit_is_called_a_file(tmp_path: Path) -> None:
    (tmp_path / "kit").touch()
    with pytest.raises(ConfigInvalid, match="is a file, expected a folder"):
        write_kit(tmp_path / "kit", draw_frames)
