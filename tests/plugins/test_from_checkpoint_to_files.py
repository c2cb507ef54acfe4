"""A user's walk: from a checkpoint to a picture, a validated model and a SOG, a command each.

The checkpoints are a gsplat ``.pt``, a Scaffold-GS folder and a SpacetimeGaussians PLY. Every
command runs in a process of its own.
"""

import json
import math
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from gsgen.formats import open_splats
from gsgen.reference_plugins.synthetic import (
    AnchorOptions,
    torus_knot,
    write_scaffold,
    write_spacetime,
)
from support.commands import gsgen_here

BLACK = 12  # a byte of a pixel on which nothing is drawn


def write_gsplat(folder: Path) -> Path:
    """Write a checkpoint as the simple trainer of gsplat does."""
    knot = torus_knot(3000)
    tensors = {
        "means": knot.position, "quats": knot.rotation, "scales": knot.log_scale,
        "opacities": knot.logit_opacity, "sh0": knot.sh[:, :1], "shN": knot.sh[:, 1:],
    }  # fmt: skip
    splats = {name: torch.from_numpy(array.copy()) for name, array in tensors.items()}
    path = folder / "results/ckpts/ckpt_29999_rank0.pt"
    path.parent.mkdir(parents=True)
    torch.save({"step": 29999, "splats": splats}, path)
    return path


def write_anchors(folder: Path) -> Path:
    return write_scaffold(folder / "scaffold", AnchorOptions(anchors=400))


def write_flames(folder: Path) -> Path:
    (cloud,) = write_spacetime(folder / "run", count=3000).rglob("*.ply")
    return Path(shutil.copy(cloud, folder / "flames.ply"))


@dataclass(frozen=True, kw_only=True)
class Walk:
    """The commands of one user; {source} is the checkpoint."""

    source: str
    picture: str
    model: str
    sog: str
    psnr: float = math.inf  # what bake has to reach, in decibels; inf where nothing is fitted


WALKS = {
    "gsplat": Walk(
        source="results/ckpts/ckpt_29999_rank0.pt",
        picture="render {source} -o picture.png",
        model="export static {source} -o model.onnx",
        sog="convert {source} out.sog --json",
    ),
    "scaffold": Walk(
        source="scaffold",
        picture="render model.onnx -o picture.png",
        model="export scaffold-gs --checkpoint {source} -o model.onnx",
        sog="bake model.onnx -o out.sog --json",
        psnr=30,
    ),
    "spacetime": Walk(
        source="flames.ply",
        picture="render model.onnx -o picture.png --time 0.5",
        model="export spacetime-gaussians --checkpoint {source} -o model.onnx",
        sog="bake model.onnx -o out.sog --time 0.5 --psnr --json",
        psnr=40,
    ),
}
WRITERS = {"gsplat": write_gsplat, "scaffold": write_anchors, "spacetime": write_flames}


def run(command: str, source: str, cwd: Path) -> str:
    completed = gsgen_here(*command.format(source=source).split(), cwd=cwd)
    assert completed.code == 0, (command, completed.err)
    assert "Traceback" not in completed.err
    return completed.out


def drawn_share(path: Path) -> float:
    """Return the share of pixels on which something is drawn."""
    pixels = np.asarray(Image.open(path).convert("RGB"))
    return float((pixels.max(axis=2) > BLACK).mean())


@pytest.mark.parametrize("name", WALKS)
def test_a_command_each_gives_a_model_a_picture_and_a_sog(name: str, tmp_path: Path) -> None:
    walk = WALKS[name]
    WRITERS[name](tmp_path)
    assert "conforms" in run(walk.model, walk.source, tmp_path)
    validated = gsgen_here("validate", "model.onnx", "--target", "webgpu", cwd=tmp_path)
    assert validated.code == 0, validated.out
    run(walk.picture, walk.source, tmp_path)
    assert drawn_share(tmp_path / "picture.png") > 0.02
    report = json.loads(run(walk.sog, walk.source, tmp_path))
    if walk.psnr < math.inf:
        (frame,) = report["frames"]
        assert frame["psnr"] >= walk.psnr
    splats = open_splats(tmp_path / "out.sog")
    assert 1500 < len(splats) <= 3000
    run("render out.sog -o again.png", "", tmp_path)
    assert drawn_share(tmp_path / "again.png") > 0.02


@pytest.mark.parametrize(
    ("name", "command", "hint"),
    [
        ("spacetime", "render {source} -o x.png", "gsgen export spacetime-gaussians --checkpoint"),
        ("spacetime", "convert {source} x.sog", "gsgen export spacetime-gaussians --checkpoint"),
        ("scaffold", "render {source} -o x.png", "gsgen export METHOD --checkpoint FOLDER"),
        ("scaffold", "convert {source} x.sog", "`gsgen plugins` lists the methods"),
        (
            "scaffold",
            "export octree-gs --checkpoint {source} -o x.onnx",
            "gsgen export scaffold-gs",
        ),
    ],
)
def test_a_step_too_early_names_the_right_command(
    name: str, command: str, hint: str, tmp_path: Path
) -> None:
    WRITERS[name](tmp_path)
    source = WALKS[name].source
    completed = gsgen_here(*command.format(source=source).split(), cwd=tmp_path)
    assert completed.code == 4, completed.err
    assert hint in completed.err
    assert "Traceback" not in completed.err


def test_the_plugins_of_the_walk_are_listed(tmp_path: Path) -> None:
    entries = {entry["name"]: entry for entry in json.loads(gsgen_here("plugins", "--json").out)}
    for name in ("static", "scaffold-gs", "spacetime-gaussians"):
        assert entries[name]["usable"]
    readme = (Path(__file__).parents[2] / "README.md").read_text("utf-8")
    for name in entries:
        if entries[name]["package"].startswith("gsgen "):
            assert f"](docs/plugins/{name}.md)" in readme
