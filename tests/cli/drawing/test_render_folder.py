"""The folder of a 3DGS training in commands that draw."""

import json
from pathlib import Path

import pytest

from gsgen.cli.commands.drawing.opening import training_camera
from gsgen.formats import write_ply
from support.splat_files import scene

IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


def folder_of_training(folder: Path, cameras: list[dict]) -> Path:
    cloud = folder / "point_cloud/iteration_30/point_cloud.ply"
    cloud.parent.mkdir(parents=True)
    write_ply(cloud, scene(10, 0))
    (folder / "cameras.json").write_text(json.dumps(cameras))
    return folder


def test_the_first_camera_of_a_training_is_chosen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    size = {"width": 20, "height": 10, "fx": 9, "fy": 9}
    cameras = [
        {
            "id": number,
            "img_name": f"c{number}",
            "position": [0, 0, -5],
            "rotation": IDENTITY,
            **size,
        }
        for number in range(3)
    ]
    folder = folder_of_training(tmp_path / "run", cameras)
    assert training_camera([folder]) == f"{folder}/cameras.json#c0"
    assert "the first of 3" in capsys.readouterr().err


def test_a_camera_file_without_cameras_is_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_of_training(tmp_path / "run", [])
    assert training_camera([folder]) is None
    assert "not used: " in capsys.readouterr().err


def test_other_scenes_have_no_camera(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", scene(3, 0))
    assert training_camera([tmp_path / "a.ply", tmp_path / "missing.onnx"]) is None
