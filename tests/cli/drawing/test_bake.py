"""`gsgen bake`, as a user gets it."""

import json
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from gsgen.formats import open_splats
from support.commands import gsgen, gsgen_here


@pytest.fixture(scope="module")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bake")
    for name in ("drift", "growing", "avatar", "fade_column", "post_process"):
        find(name).write(folder)
    return folder


def test_a_range_of_times_becomes_a_folder_of_files(models: Path, tmp_path: Path) -> None:
    pattern = tmp_path / "seq" / "%04d.spz"
    completed = gsgen("bake", models / "drift.onnx", "-o", pattern, "--time", "0:1:3")
    assert (completed.code, completed.err) == (0, "")
    assert "3 frames" in completed.out
    assert "0000.spz … " in completed.out
    names = sorted(path.name for path in (tmp_path / "seq").iterdir())
    assert names == ["0000.spz", "0001.spz", "0002.spz"]
    first, last = (open_splats(tmp_path / "seq" / name) for name in (names[0], names[2]))
    assert len(first) == len(last)
    assert not np.array_equal(first.position, last.position)


def test_the_report_is_json(models: Path, tmp_path: Path) -> None:
    file = tmp_path / "column.ply"
    completed = gsgen_here(
        "bake", models / "fade_column.onnx", "-o", file, "--json", "--views", "20"
    )
    assert completed.code == 0
    document = json.loads(completed.out)
    (frame,) = document["frames"]
    assert frame["file"] == str(file)
    assert frame["count"] == len(open_splats(file))
    assert frame["bytes"] == file.stat().st_size
    assert frame["psnr"] > 40
    assert document["view_dependence"].startswith("rows")
    assert document["notes"][0] in completed.err


def test_pose_file_gives_one_frame_per_pose(models: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "walk.npy", np.random.default_rng(0).normal(0, 0.2, (2, 4, 3)))
    words = ("-o", tmp_path / "%d.glb", "--pose", tmp_path / "walk.npy", "--json")
    completed = gsgen_here("bake", models / "avatar.onnx", *words)
    assert completed.code == 0, completed.err
    assert len(json.loads(completed.out)["frames"]) == 2
    a, b = (open_splats(tmp_path / f"{number}.glb") for number in range(2))
    assert not np.array_equal(a.position, b.position)


@pytest.mark.parametrize(
    ("model", "words", "code", "parts"),
    [
        ("drift", ("-o", "a.ply", "--time", "7"), 2, ("--time", "7", "expected 0 to 1")),
        ("drift", ("-o", "a.ply", "--time", "0:1"), 2, ("--time", "FIRST:LAST:COUNT")),
        ("avatar", ("-o", "a.ply", "--time", "0"), 2, ("--time", "no time input")),
        ("drift", ("-o", "a.ksplat"), 2, ("a.ksplat", "can only be read", ".ply")),
        ("drift", ("-o", "a.ply", "--time", "0:1:2"), 2, ("a.ply", "a_%04d.ply")),
        ("drift", ("-o", "a.ply", "--input", "tme=0"), 2, ("tme", "time")),
        ("drift", ("-o", "a.ply", "--input", "time=0..1"), 2, ("FIRST:LAST:COUNT",)),
        (
            "drift",
            ("-o", "a.ply", "--pose", "walk.npy"),
            2,
            ("--pose", "the input 'pose', which no scene has"),
        ),
        ("drift", ("-o", "file/a.ply"), 2, ("file/a.ply", "cannot be written")),
        ("post_process", ("-o", "a.ply"), 2, ("post_process.onnx", "post-process")),
        ("missing", ("-o", "a.ply"), 4, ("missing.onnx", "No such file")),
    ],
)
def test_invalid_options_are_reported_with_a_hint(
    models: Path,
    tmp_path: Path,
    model: str,
    words: tuple[str, ...],
    code: int,
    parts: tuple[str, ...],
) -> None:
    (tmp_path / "file").touch()
    completed = gsgen_here("bake", models / f"{model}.onnx", *words, cwd=tmp_path)
    assert completed.code == code, completed.err
    assert "Traceback" not in completed.err
    for part in parts:
        assert part in completed.err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
