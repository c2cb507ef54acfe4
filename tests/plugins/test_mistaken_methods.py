"""A run of one method, given to the plugin of another."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gsgen.reference_plugins.checkpoints.anchors import read_anchors
from gsgen.reference_plugins.checkpoints.cells import read_cells
from gsgen.reference_plugins.checkpoints.deformations import read_deformation
from gsgen.reference_plugins.checkpoints.errors import CheckpointInvalid
from gsgen.reference_plugins.checkpoints.gauhuman import read_gauhuman
from gsgen.reference_plugins.checkpoints.hexplanes import read_hexplanes
from gsgen.reference_plugins.checkpoints.r3_avatar import read_r3
from gsgen.reference_plugins.synthetic import (
    AnchorOptions,
    HexPlaneOptions,
    PersonOptions,
    write_deformable,
    write_duplex,
    write_gauhuman,
    write_hexplane,
    write_octree,
    write_r3,
    write_scaffold,
)

UNITED, PERSON = AnchorOptions(anchors=6, united=True), PersonOptions(count=4, nets=True)
METHODS: dict[str, tuple[Callable[[Path], Path], Callable[[Path], Any]]] = {
    "scaffold-gs": (lambda f: write_scaffold(f, UNITED), read_anchors),
    "octree-gs": (
        lambda f: write_octree(f, UNITED),
        lambda f: read_anchors(f, octree=True),
    ),
    "duplex-gs": (lambda f: write_duplex(f, UNITED), read_cells),
    "hexplane-4dgs": (
        lambda f: write_hexplane(f, HexPlaneOptions(count=4)),
        read_hexplanes,
    ),
    "deformable-3dgs": (lambda f: write_deformable(f, count=4), read_deformation),
    "gauhuman": (lambda f: write_gauhuman(f, PERSON), read_gauhuman),
    "r3-avatar": (lambda f: write_r3(f, PERSON), read_r3),
}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    home = tmp_path_factory.mktemp("runs")
    made = {name: write(home / name) for name, (write, _) in METHODS.items()}
    # Training of R3-Avatar writes the files of GauHuman, too; they are not enough for it.
    for place in ("point_cloud", "mlp_ckpt"):
        target = made["r3-avatar"] / place
        target.symlink_to(made["gauhuman"] / place)
    return made


@pytest.mark.parametrize("plugin", METHODS)
def test_the_right_plugin_is_named(plugin: str, runs: dict[str, Path]) -> None:
    read = METHODS[plugin][1]
    read(runs[plugin])
    for name, run in runs.items():
        if name == plugin or (name == "r3-avatar" and plugin != "gauhuman"):
            continue
        with pytest.raises(CheckpointInvalid, match="is a checkpoint of") as caught:
            read(run)
        assert caught.value.mend == f"Export it with `gsgen export {name}`."


def test_a_resume_file_of_gauhuman_is_not_taken_for_one_of_r3(
    runs: dict[str, Path],
) -> None:
    run = runs["gauhuman"]
    (run / "chkpnt1200.pth").write_bytes(b"PK but no archive")
    assert read_gauhuman(run).nets is not None
    with pytest.raises(CheckpointInvalid, match="cannot be read"):
        read_r3(run, dataset="zju")
