"""Every field of a camera file is used, or named in one note."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.runtime.camera_files import open_cameras
from gsgen.runtime.playback.camera_options import viewpoint

EYE4 = np.eye(4).tolist()
FRAME = {"file_path": "a.png", "transform_matrix": EYE4}
TRANSFORMS = {"w": 8, "h": 6, "fl_x": 9.0, "frames": [FRAME]}
TRAINED = {
    "img_name": "a",
    "width": 8,
    "height": 6,
    "fx": 9.0,
    "fy": 9.0,
    "position": [0, 0, 0],
    "rotation": np.eye(3).tolist(),
}
PATH_FRAME = {"camera_to_world": np.eye(4).ravel().tolist(), "fov": 50.0}
PATH = {"render_width": 8, "render_height": 6, "camera_path": [PATH_FRAME]}

# A document, and the names of its fields without a use.
DOCUMENTS: dict[str, tuple[Any, str]] = {
    "nothing unused": (TRANSFORMS, ""),
    "shared field": (TRANSFORMS | {"aabb_scale": 16}, "aabb_scale"),
    "field of one frame": (
        TRANSFORMS | {"frames": [FRAME, FRAME | {"sharpness": 3.0}]},
        "sharpness",
    ),
    "fields in the order of the file": (
        TRANSFORMS | {"zeta": 1, "alpha": 2, "frames": [FRAME | {"mask_path": "m"}]},
        "zeta, alpha, mask_path",
    ),
    "time is used": (TRANSFORMS | {"frames": [FRAME | {"time": 0.5}]}, ""),
    "shared focal length overridden": (
        TRANSFORMS | {"frames": [FRAME | {"fl_x": 7.0}, FRAME | {"fl_x": 8.0}]},
        "",
    ),
    "angles beside lengths": (TRANSFORMS | {"camera_angle_x": 0.8, "camera_angle_y": 0.6}, ""),
    "coefficients of no distortion": (TRANSFORMS | {"k1": 0, "k2": 0.0, "p1": 0, "p2": 0}, ""),
    "training": ([TRAINED | {"id": 3}], ""),
    "training with a field": ([TRAINED, TRAINED | {"exposure": 1.5}], "exposure"),
    "path": (PATH | {"fps": 24, "seconds": 1}, ""),
    "path with fields": (
        PATH | {"keyframes": [], "crop": {}, "camera_path": [PATH_FRAME | {"aspect": 1.0}]},
        "keyframes, crop, aspect",
    ),
    "path with times": (PATH | {"camera_path": [PATH_FRAME | {"render_time": 0.2}]}, ""),
}


@pytest.mark.parametrize("name", DOCUMENTS)
def test_fields_without_a_use_are_named_in_one_note(name: str, tmp_path: Path) -> None:
    document, unused = DOCUMENTS[name]
    path = tmp_path / "file.json"
    path.write_text(json.dumps(document))
    expected = (f"{path}: not used: {unused}",) if unused else ()
    assert open_cameras(path).notes == expected
    assert viewpoint(str(path)).notes == expected


def test_a_field_with_any_name_in_any_object_is_named(tmp_path: Path) -> None:
    """Random names, at the file's level or a frame's: the mechanism has no list of names."""
    rng = np.random.default_rng(7)
    for _ in range(40):
        name = "".join(rng.choice(list("abcdefghij_"), 12))
        level = [dict(TRANSFORMS, frames=[dict(FRAME), dict(FRAME)])]
        level += level[0]["frames"]  # type: ignore[arg-type]
        level[rng.integers(3)][name] = 1
        path = tmp_path / "transforms.json"
        path.write_text(json.dumps(level[0]))
        assert open_cameras(path).notes == (f"{path}: not used: {name}",)


def test_many_unused_fields_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(TRANSFORMS | {f"field_{n}": 0 for n in range(30)}))
    (note,) = open_cameras(path).notes
    assert note.endswith("field_22, field_23 and 6 more")
