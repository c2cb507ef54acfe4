from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.reference_plugins.checkpoints.anchors import (
    AnchorCheckpoint,
    read_anchors,
)
from gsgen.reference_plugins.octree_gs import MODES, Levels, OctreeGS
from gsgen.reference_plugins.prefilter import Prefilter
from gsgen.reference_plugins.scaffold_gs import ScaffoldGS
from gsgen.reference_plugins.synthetic import AnchorOptions, write_octree, write_scaffold
from gsgen.sdk import GaussianGenerator
from support.commands import shared
from support.plugin_checks import assert_like, camera, eager
from support.plugin_oracles import anchors

ROUNDS = 12


def options(rng: np.random.Generator, **fixed: object) -> AnchorOptions:
    appearance = int(rng.integers(0, 2)) * int(rng.integers(1, 9))
    chosen: dict[str, object] = {
        "anchors": int(rng.integers(2, 40)),
        "per_anchor": int(rng.integers(1, 12)),
        "width": 4 * int(rng.integers(1, 9)),
        "bank": bool(rng.integers(0, 2)),
        "distance": tuple(bool(x) for x in rng.integers(0, 2, 3)),
        "appearance": appearance,
        "cameras": int(rng.integers(2, 6)) if appearance else 0,
        "united": True,
        "seed": int(rng.integers(0, 1000)),
    }
    return AnchorOptions(**(chosen | fixed))  # type: ignore[arg-type]


def octree(read: AnchorCheckpoint, **chosen: object) -> OctreeGS:
    return OctreeGS(read.cloud, read.nets, Levels.of(read), **chosen)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_scaffold_does_what_the_method_does(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    read = read_anchors(write_scaffold(tmp_path, options(rng)))
    generator = ScaffoldGS(read.cloud, read.nets)
    cameras = len(read.nets.embedding) if read.nets.embedding is not None else 0
    for scale in (1.0, 0.3):
        view = camera(rng, 3.0, scale)
        uid = int(rng.integers(0, cameras)) if cameras else None
        given = [view, *([np.array([uid], np.int32)] if cameras else [])]
        rows, color = eager(generator, *given)
        assert_like(rows, color, anchors(read, view, uid, octree=False))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", range(ROUNDS // 3))
def test_octree_does_what_the_method_does(seed: int, mode: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(100 + seed)
    fork, levels = int(rng.integers(2, 5)), int(rng.integers(1, 6))
    chosen = options(rng, anchors=60, level=bool(rng.integers(0, 2)), iteration=40000)
    read = read_anchors(
        write_octree(tmp_path, chosen, mode=mode, fork=fork, levels=levels), octree=True
    )
    generator = octree(read, appearance=1 if chosen.cameras else None)
    hidden = 0
    for distance in (1.5, 4.0, 12.0, 40.0):
        view = camera(rng, distance)
        rows, color = eager(generator, view)
        wanted = anchors(read, view, 1 if chosen.cameras else None, octree=True)
        assert_like(rows, color, wanted)
        hidden += int((~wanted.kept).sum())
    assert hidden, "no distance hid any level, so nothing was tried"


@pytest.mark.parametrize("kind", ["scaffold", "octree"])
def test_a_fixed_appearance_is_the_chosen_one(kind: str, tmp_path: Path) -> None:
    write = write_scaffold if kind == "scaffold" else write_octree
    read = read_anchors(
        write(tmp_path, AnchorOptions(cameras=4, appearance=6, united=True)),
        octree=kind == "octree",
    )

    def make(**chosen: object) -> GaussianGenerator:
        if kind == "octree":
            return octree(read, **chosen)
        return ScaffoldGS(read.cloud, read.nets, **chosen)  # type: ignore[arg-type]

    view = camera(np.random.default_rng(0))
    rows, color = eager(make(appearance=2), view)
    assert [one.role for one in make(appearance=2).inputs] == ["view"]
    chosen_rows, chosen_color = eager(make(), view, np.array([2], np.int32))
    np.testing.assert_allclose(rows, chosen_rows, atol=1e-6)
    np.testing.assert_allclose(color, chosen_color, atol=1e-6)
    other = eager(make(), view, np.array([1], np.int32))[1]
    assert np.abs(other - color).max() > 0.01


@pytest.mark.parametrize("kind", ["scaffold", "octree"])
def test_no_camera_gives_anything_but_numbers(kind: str, tmp_path: Path) -> None:
    chosen = AnchorOptions(bank=True, distance=(True, True, True), united=True)
    if kind == "scaffold":
        read = read_anchors(write_scaffold(tmp_path, chosen))
        generator: GaussianGenerator = ScaffoldGS(read.cloud, read.nets, prefilter=True)
    else:
        read = read_anchors(write_octree(tmp_path, chosen, mode="progressive"), octree=True)
        generator = octree(read, prefilter=True)
    lens, size = np.eye(4, dtype=np.float32), np.array([64, 48], np.float32)
    inside = np.eye(4, dtype=np.float32)
    inside[3, :3] = -read.cloud.position[5].numpy()  # the camera stands on an anchor
    for view in (np.zeros((4, 4), np.float32), inside):
        for given in ((lens, size), (0 * lens, 0 * size)):
            rows, color = eager(generator, view, *given)
            assert np.isfinite(rows).all()
            assert np.isfinite(color).all()


@pytest.mark.parametrize("case", ["scaffold_a", "octree_a"])
def test_the_prefilter_is_that_of_the_published_renderer(case: str) -> None:
    golden = np.load(shared(f"data/checkpoints/{case}/golden.npz"))
    is_octree = case.startswith("octree")
    read = read_anchors(shared(f"data/checkpoints/{case}/ckpt"), octree=is_octree)
    test = Prefilter(read.cloud)
    for index in range(3):
        lens = torch.from_numpy(golden["in_projection_matrix"][index])
        view = torch.from_numpy(golden["in_world_view_transform"][index])
        shown = test(view, lens, torch.from_numpy(golden["in_size"][index]).float())
        wanted = golden[f"out{index}_prefilter"]
        looked_at = (
            golden[f"out{index}_anchor_mask"] if is_octree else np.full(len(wanted), True)
        )
        np.testing.assert_array_equal(
            shown.numpy().ravel()[looked_at] > 0, wanted[looked_at]
        )


def test_a_filtered_anchor_has_no_opacity_and_others_keep_theirs(tmp_path: Path) -> None:
    read = read_anchors(write_scaffold(tmp_path, AnchorOptions(united=True)))
    view = camera(np.random.default_rng(3), 1.0)
    lens, size = 2 * np.eye(4, dtype=np.float32), np.array([64, 48], np.float32)
    plain, _ = eager(ScaffoldGS(read.cloud, read.nets), view)
    filtered, _ = eager(ScaffoldGS(read.cloud, read.nets, prefilter=True), view, lens, size)
    shown = Prefilter(read.cloud)(*map(torch.from_numpy, (view, lens, size)))
    mask = np.repeat(shown.numpy().ravel(), read.cloud.per_anchor)
    assert 0 < mask.sum() < len(mask)
    np.testing.assert_array_equal(filtered[:, 3], plain[:, 3] * mask)
    np.testing.assert_array_equal(filtered[:, 4:], plain[:, 4:])
