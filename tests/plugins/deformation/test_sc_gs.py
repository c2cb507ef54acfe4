from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gsgen.reference_plugins.deformation import sc_gs_plugin as plugin
from gsgen.reference_plugins.deformation.sc_gs import ScGs, node_weights
from gsgen.reference_plugins.deformation.sc_gs_checkpoint import read_sc_gs
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.synthetic import write_sc_gs
from plugins.deformation.control_node_oracle import control_nodes
from support.checkpoints.plugin_checks import assert_like, eager

VARIANTS: tuple[dict[str, Any], ...] = (
    {},
    {"is_blender": False, "K": 4, "hyper_dim": 0},
    {"local_frame": True, "gs_with_motion_mask": True},
    {"pred_opacity": True, "max_d_scale": 10.0, "K": 1},
    {"pred_color": True, "d_rot_as_res": False, "gs_with_motion_mask": True},
    {"local_frame": True, "pred_opacity": True, "pred_color": True, "is_blender": False, "K": 2},
)


def moment(time: float) -> np.ndarray:
    return np.array([time], np.float32)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("options", VARIANTS)
def test_nodes_carry_gaussians_as_the_method_does(
    options: dict[str, Any], seed: int, tmp_path: Path
) -> None:
    blender = options.get("is_blender", True)
    write_sc_gs(tmp_path, count=31, options=options, blender=blender, seed=seed)
    generator = ScGs(read_sc_gs(tmp_path))
    for time in (0.0, 0.37, 1.0, 1.2):  # frame numbers of tests may leave [0, 1]
        expected = control_nodes(tmp_path, float(np.float32(time)), options)
        assert_like(*eager(generator, moment(time)), expected)


def test_weights_are_the_same_in_parts(tmp_path: Path) -> None:
    read = read_sc_gs(write_sc_gs(tmp_path, count=9000, nodes=20))
    points = torch.cat([read.canonical.position, read.hyper_features], dim=1)
    index, weight = node_weights(points, read.nodes, 3)
    assert torch.allclose(weight.sum(dim=1), torch.ones(9000, dtype=torch.float64))
    for start in (0, 8190, 8999):
        part = node_weights(points[start : start + 1], read.nodes, 3)
        assert torch.equal(index[start : start + 1], part[0])
        assert torch.equal(weight[start : start + 1], part[1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"use_hash": True}, "use_hash is True, expected False"),
        ({"deform_type": "mlp"}, "deform_type is 'mlp', expected 'node'"),
        ({"progressive_brand_time": True}, "progressive_brand_time is True"),
        ({"K": 13}, "K is 13, but there are 12 nodes"),
    ],
)
def test_other_variants_are_refused(options: dict[str, Any], message: str, tmp_path: Path) -> None:
    write_sc_gs(tmp_path, count=3, options=options)
    with pytest.raises(CheckpointInvalid, match=message):
        read_sc_gs(tmp_path)


def test_checkpoint_that_contradicts_its_options_is_named(tmp_path: Path) -> None:
    run = write_sc_gs(tmp_path, count=3, options={"pred_color": True})
    cfg = (run / "cfg_args").read_text()
    for old, new, message in (
        ("pred_color=True", "pred_color=False", "pred_color is False, but the network in"),
        ("hyper_dim=2", "hyper_dim=2, gs_with_motion_mask=True", "has 2 properties fea_N, exp"),
    ):
        (run / "cfg_args").write_text(cfg.replace(old, new))
        with pytest.raises(CheckpointInvalid, match=message):
            read_sc_gs(run)
    (run / "cfg_args").unlink()
    with pytest.raises(CheckpointInvalid, match="cfg_args"):
        read_sc_gs(run)
    (run / "cfg_args").write_text(cfg)
    (path,) = run.rglob("deform.pth")
    state = torch.load(path, weights_only=True)
    del state["nodes"]
    torch.save(state, path)
    with pytest.raises(CheckpointInvalid, match="nodes is") as caught:
        read_sc_gs(run)
    assert "control nodes" in caught.value.hint


def test_a_rotation_option_that_rendering_ignores_is_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = {"d_rot_as_rotmat": True, "d_rot_as_res": True}
    run = write_sc_gs(tmp_path, count=5, options=options)
    generator = plugin.build(run)
    assert "warning: d_rot_as_rotmat=True" in capsys.readouterr().err
    expected = control_nodes(run, 0.5, options)
    assert_like(*eager(generator, moment(0.5)), expected)
