from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.reference_plugins.anchors.anchor_checkpoint import AnchorCheckpoint, read_anchors
from gsgen.reference_plugins.anchors.octree_gs import LEVEL_ROUNDING, Levels, OctreeGS
from gsgen.reference_plugins.anchors.prefilter import Prefilter
from gsgen.reference_plugins.anchors.scaffold_gs import ScaffoldGS
from gsgen.reference_plugins.anchors.selection import Frustum, Selection
from gsgen.reference_plugins.synthetic import AnchorOptions, write_octree, write_scaffold
from gsgen.reference_plugins.tensors.layers import proportion
from gsgen.sdk import GaussianGenerator, export
from support.checkpoints.plugin_checks import assert_like, camera, eager, run
from support.checkpoints.plugin_oracles import anchors
from support.commands import shared

ROUNDS = 12
PUBLISHED = Selection("published")


def options(rng: np.random.Generator, **fixed: object) -> AnchorOptions:
    appearance = int(rng.integers(0, 2)) * int(rng.integers(1, 9))
    settings: dict[str, object] = {
        "anchors": int(rng.integers(2, 40)),
        "per_anchor": int(rng.integers(1, 12)),
        "width": 4 * int(rng.integers(1, 9)),
        "has_feature_bank": bool(rng.integers(0, 2)),
        "distance": tuple(bool(x) for x in rng.integers(0, 2, 3)),
        "appearance": appearance,
        "cameras": int(rng.integers(2, 6)) if appearance else 0,
        "is_single_file": True,
        "seed": int(rng.integers(0, 1000)),
    }
    return AnchorOptions(**(settings | fixed))  # type: ignore[arg-type]


def octree(read: AnchorCheckpoint, **settings: object) -> OctreeGS:
    return OctreeGS(read.cloud, read.nets, Levels.of(read), **settings)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_scaffold_does_what_the_method_does(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    read = read_anchors(write_scaffold(tmp_path, options(rng)))
    generator = ScaffoldGS(read.cloud, read.nets)
    cameras = len(read.nets.embedding) if read.nets.embedding is not None else 0
    for scale in (1.0, 0.3):
        view = camera(rng, 3.0, scale)
        uid = int(rng.integers(0, cameras)) if cameras else None
        arrays = [view, *([np.array([uid], np.int32)] if cameras else [])]
        rows, color = eager(generator, *arrays)
        assert_like(rows, color, anchors(read, view, uid, octree=False))


@pytest.mark.parametrize("mode", LEVEL_ROUNDING)
@pytest.mark.parametrize("seed", range(ROUNDS // 3))
def test_octree_does_what_the_method_does(seed: int, mode: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(100 + seed)
    fork, levels = int(rng.integers(2, 5)), int(rng.integers(1, 6))
    settings = options(rng, anchors=60, level=bool(rng.integers(0, 2)), iteration=40000)
    read = read_anchors(
        write_octree(tmp_path, settings, mode=mode, fork=fork, levels=levels), octree=True
    )
    generator = octree(read, appearance=1 if settings.cameras else None)
    hidden = 0
    for distance in (1.5, 4.0, 12.0, 40.0):
        view = camera(rng, distance)
        rows, color = eager(generator, view)
        expected = anchors(read, view, 1 if settings.cameras else None, octree=True)
        assert_like(rows, color, expected)
        hidden += int((~expected.retained).sum())
    assert hidden, "no distance hid any level, so nothing was tried"


@pytest.mark.parametrize("kind", ["scaffold", "octree"])
def test_a_fixed_appearance_is_the_chosen_one(kind: str, tmp_path: Path) -> None:
    write = write_scaffold if kind == "scaffold" else write_octree
    read = read_anchors(
        write(tmp_path, AnchorOptions(cameras=4, appearance=6, is_single_file=True)),
        octree=kind == "octree",
    )

    def make(**settings: object) -> GaussianGenerator:
        if kind == "octree":
            return octree(read, **settings)
        return ScaffoldGS(read.cloud, read.nets, **settings)  # type: ignore[arg-type]

    view = camera(np.random.default_rng(0))
    rows, color = eager(make(appearance=2), view)
    assert [declared.role for declared in make(appearance=2).inputs] == ["view"]
    chosen_rows, chosen_color = eager(make(), view, np.array([2], np.int32))
    np.testing.assert_allclose(rows, chosen_rows, atol=1e-6)
    np.testing.assert_allclose(color, chosen_color, atol=1e-6)
    other_color = eager(make(), view, np.array([1], np.int32))[1]
    assert np.abs(other_color - color).max() > 0.01


@pytest.mark.parametrize("kind", ["scaffold", "octree"])
def test_every_camera_gives_finite_outputs(kind: str, tmp_path: Path) -> None:
    settings = AnchorOptions(
        has_feature_bank=True, distance=(True, True, True), is_single_file=True
    )
    if kind == "scaffold":
        read = read_anchors(write_scaffold(tmp_path, settings))
        generator: GaussianGenerator = ScaffoldGS(read.cloud, read.nets, selection=PUBLISHED)
    else:
        read = read_anchors(write_octree(tmp_path, settings, mode="progressive"), octree=True)
        generator = octree(read, selection=PUBLISHED)
    lens, size = np.eye(4, dtype=np.float32), np.array([64, 48], np.float32)
    inside = np.eye(4, dtype=np.float32)
    inside[3, :3] = -read.cloud.position[5].numpy()  # the camera stands on an anchor
    for view in (np.zeros((4, 4), np.float32), inside):
        for lens_and_size in ((lens, size), (0 * lens, 0 * size)):
            rows, color = eager(generator, view, *lens_and_size)
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
        visible = test(view, lens, torch.from_numpy(golden["in_size"][index]).float())
        expected = golden[f"out{index}_prefilter"]
        expected_mask = (
            golden[f"out{index}_anchor_mask"] if is_octree else np.full(len(expected), True)
        )
        np.testing.assert_array_equal(
            visible.numpy().ravel()[expected_mask] > 0, expected[expected_mask]
        )


def test_a_filtered_anchor_has_no_opacity_and_others_keep_theirs(tmp_path: Path) -> None:
    read = read_anchors(write_scaffold(tmp_path, AnchorOptions(is_single_file=True)))
    view = camera(np.random.default_rng(3), 1.0)
    lens, size = 2 * np.eye(4, dtype=np.float32), np.array([64, 48], np.float32)
    unfiltered, _ = eager(ScaffoldGS(read.cloud, read.nets), view)
    filtered, _ = eager(ScaffoldGS(read.cloud, read.nets, selection=PUBLISHED), view, lens, size)
    visible = Prefilter(read.cloud)(*map(torch.from_numpy, (view, lens, size)))
    mask = np.repeat(visible.numpy().ravel(), read.cloud.per_anchor)
    assert 0 < mask.sum() < len(mask)
    np.testing.assert_array_equal(filtered[:, 3], unfiltered[:, 3] * mask)
    np.testing.assert_array_equal(filtered[:, 4:], unfiltered[:, 4:])


def lens(width: float, height: float, focal: float) -> tuple[np.ndarray, np.ndarray]:
    matrix = np.zeros((4, 4), np.float32)
    matrix[0, 0], matrix[1, 1] = focal, -focal * width / height
    matrix[2, 2:] = 1.0, 1.0  # column order: z' = z - 0.1, w' = z
    matrix[3, 2] = -0.1
    return matrix, np.array([width, height], np.float32)


def test_no_gaussian_in_the_image_is_culled(tmp_path: Path) -> None:
    read = read_anchors(write_scaffold(tmp_path, AnchorOptions(anchors=500, is_single_file=True)))
    projection, _ = lens(64, 48, 1.5)
    rng, culled = np.random.default_rng(5), 0
    for distance in (0.3, 1.0, 2.0):
        view = camera(rng, distance)
        retained = Frustum(read.cloud)(torch.from_numpy(view), torch.from_numpy(projection))
        rows, _ = eager(ScaffoldGS(read.cloud, read.nets), view)
        clip = np.c_[rows[:, :3], np.ones(len(rows))] @ view @ projection
        inside = (np.abs(clip[:, :2]) <= clip[:, 3:]).all(axis=1) & (clip[:, 2] > 0)
        hidden = np.repeat(retained.numpy().ravel() == 0, read.cloud.per_anchor)
        assert not (inside & hidden).any()
        culled += int(hidden.sum())
    assert culled > 500


@pytest.mark.parametrize("kind", ["scaffold", "octree"])
def test_decoding_fewer_anchors_gives_the_same_rows_in_front(kind: str, tmp_path: Path) -> None:
    settings = AnchorOptions(
        anchors=300, has_feature_bank=True, distance=(True, True, True), cameras=2, appearance=3,
        level=kind == "octree", is_single_file=True,
    )  # fmt: skip
    write = write_scaffold if kind == "scaffold" else write_octree
    read = read_anchors(write(tmp_path, settings), octree=kind == "octree")

    def make(selection: Selection) -> GaussianGenerator:
        if kind == "octree":
            return octree(read, selection=selection)
        return ScaffoldGS(read.cloud, read.nets, selection=selection)

    rng, k = np.random.default_rng(7), read.cloud.per_anchor
    arrays = (camera(rng, 1.5), lens(64, 48, 1.2)[0], np.array([1], np.int32))
    tensors = [torch.from_numpy(array) for array in arrays]
    with torch.no_grad():
        all_anchors = make(Selection("frustum"))(*tensors)
        hidden = all_anchors.opacity.reshape(-1, k).amax(dim=1) == 0
        for most in (250, 40):
            limited = make(Selection("frustum", most))(*tensors)
            count = int(limited.count)
            assert count % k == 0
            assert limited.position.shape == (most * k, 3)
            # Anchors that are decoded, found again by where their Gaussians are.
            where = {tuple(p): i for i, p in enumerate(all_anchors.position[::k].tolist())}
            order = [where[tuple(p)] for p in limited.position[:count:k].tolist()]
            assert order == sorted(order)
            unfinished_probes = set(range(len(hidden))) - set(order)
            assert all(hidden[i] or i > order[-1] for i in unfinished_probes)
            assert len(order) == most or all(hidden[i] for i in unfinished_probes)
            rows = (torch.tensor(order)[:, None] * k + torch.arange(k)).reshape(-1)
            for name in ("opacity", "covariance", "rgb"):
                a, b = getattr(limited, name)[:count], getattr(all_anchors, name)[rows]
                torch.testing.assert_close(a, b, atol=1e-6, rtol=1e-5)


def test_gaussians_far_smaller_than_their_anchor_are_exported(tmp_path: Path) -> None:
    folder = write_scaffold(tmp_path, AnchorOptions(anchors=6, per_anchor=2, is_single_file=True))
    file = folder / "point_cloud/iteration_30000/checkpoints.pth"
    nets = torch.load(file, weights_only=True)
    shrunk = torch.tensor([-11.0, -13.0, -12.0, 0, 0, 0, 0]).repeat(2)
    nets["cov_mlp"]["2.bias"] += shrunk
    torch.save(nets, file)
    read = read_anchors(folder)
    settings = Settings(level=Level.STATIC)
    export(ScaffoldGS(read.cloud, read.nets), tmp_path / "small.onnx", settings=settings)
    view = camera(np.random.default_rng(0))
    rows, *_ = run(tmp_path / "small.onnx", {"camera": view})
    expected = anchors(read, view, None, octree=False)
    np.testing.assert_array_less(expected.covariance[:, [0, 3, 5]], 1e-7)
    trace = expected.covariance[:, [0, 3, 5]].sum(axis=1, keepdims=True)
    error = np.abs(rows[expected.retained, 4:] - expected.covariance) / trace
    assert error.max() < 1e-5


@pytest.mark.parametrize("logit", [-200.0, -90.0, -79.0, -20.0, -5.0, 0.0, 5.0, 200.0])
def test_proportions_of_tiny_gaussians_are_exact(logit: float) -> None:
    actual = proportion(torch.tensor([logit])).item()
    if logit < -79:
        assert 0 <= actual < 1e-34
    else:
        assert actual == pytest.approx(1 / (1 + np.exp(-logit)), rel=1e-6)


def test_limiting_anchors_requires_a_selection(tmp_path: Path) -> None:
    read = read_anchors(write_scaffold(tmp_path, AnchorOptions(is_single_file=True)))
    with pytest.raises(GsgenError, match="no culling selects the anchors"):
        ScaffoldGS(read.cloud, read.nets, selection=Selection(anchors=10))
