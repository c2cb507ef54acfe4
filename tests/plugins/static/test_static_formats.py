"""`gsgen export static` of splats in formats other than PLY."""

import json
from pathlib import Path

import onnx
import pytest

from gsgen.formats import write_glb
from support.commands import gsgen_here
from support.splat_files import GOLDENS, scene


def manifest_of(path: Path) -> dict:
    actual = {prop.key: prop.value for prop in onnx.load(path).metadata_props}
    (text,) = [value for key, value in actual.items() if "manifest" in key.lower()]
    return dict(json.loads(text))


@pytest.mark.parametrize(
    ("options", "retained"), [((), "mip"), (("--antialias", "classic"), "classic")]
)
def test_spz_training_flags_are_kept(tmp_path, options, retained):
    model = tmp_path / "m.onnx"
    completed = gsgen_here(
        *("export", "static", GOLDENS / "degree-4.v4.spz", "-o", model, "--level", "static"),
        *options,
    )
    assert completed.code == 0, completed.err
    assert "note: SH degree 4 is cut to 3" in completed.err
    assert manifest_of(model).get("antialias", "classic") == retained


def test_glb_color_space_is_kept(tmp_path):
    write_glb(tmp_path / "a.glb", scene(3, 1, color_space="linear"))
    model = tmp_path / "m.onnx"
    completed = gsgen_here("export", "static", tmp_path / "a.glb", "-o", model, "--level", "static")
    assert completed.code == 0, completed.err
    assert '"linear"' in json.dumps(manifest_of(model)["outputs"])
