"""The files that the calls of ``natural_calls.txt`` name, and the table of these calls."""

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gsgen.conformance.fixtures import find
from support.commands import gsgen_here
from support.models.small_models import good_rows, save_moving
from support.ten_things import ten_things

TABLE = Path(__file__).parents[1] / "cli/house_rules/natural_calls.txt"


def natural_calls() -> list[tuple[str, int, str]]:
    """Return each call with its exit code, and a part of what it answers."""
    rows = [row for row in TABLE.read_text("utf-8").splitlines() if not row.startswith("#")]
    calls = (row.split(" | ", 2) for row in rows)
    return [(call, int(code), fragment) for call, code, fragment in calls]


@contextmanager
def natural_files(folder: Path) -> Iterator[Path]:
    """Write the files into a folder, and yield it."""
    with ten_things(folder):
        for name, file in (("still_rgb", "good.onnx"), ("opacity_is_logits", "bad.onnx")):
            find(name).write(folder).rename(folder / file)
        save_moving(folder / "moving.onnx", good_rows(20))
        shutil.copy(folder / "a.ply", folder / "b.ply")
        scene = {"kind": "gaussian-scene", "models": [{"path": "a.ply"}]}
        (folder / "scene.json").write_text(json.dumps(scene))
        (folder / "mesh.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        (folder / "x.fbx").write_bytes(b"Kaydara FBX Binary  \x00\x1a\x00")
        (folder / "data").mkdir()
        (folder / "data/i.jpg").write_bytes(b"\xff\xd8\xff")
        for words in (
            ("convert", "a.ply", "a.spz"),
            ("tiles", "build", "a.ply", "-o", "tiles", "--engine", "serial"),
        ):
            assert gsgen_here(*words, cwd=folder).code == 0
        yield folder
