from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.probing.probes import as_tensor, default_probes, dependency_probes
from gsgen.contract.spec.geometry import look_at
from gsgen.contract.spec.manifest import (
    Bounds,
    FutureOutput,
    ImageOutput,
    Input,
    PostProcessManifest,
    PostProcessOutputs,
    Space,
    TrajectoryManifest,
    TrajectoryOutputs,
    UncertaintyOutput,
)
from support.models.small_models import manifest_of

SHAPES = {
    "view": (4, 4),
    "projection": (4, 4),
    "time": (1,),
    "frame_index": (1,),
    "camera_position": (3,),
    "viewport": (2,),
    "pose": (24, 3),
    "shape": (10,),
    "root_translation": (3,),
    "root_rotation": (3, 3),
    "appearance_id": (1,),
    "control": (2,),
    "image": (2, 3, 8, 12),
    "image_view": (2, 4, 4),
    "image_intrinsics": (2, 3, 3),
}
DTYPES = {
    name: "int32" if name in ("frame_index", "appearance_id") else "float32" for name in SHAPES
}
RANGES = {
    "time": (2.0, 3.0),
    "frame_index": (0.0, 59.0),
    "appearance_id": (3.0, 4.0),
    "shape": (-2.0, 2.0),
    "control": (5.0, 6.0),
    "image": (-1.0, 1.0),
}


def manifest_with_roles(*roles, **changes):
    """A manifest with one input for each role, of the role's name."""
    inputs = tuple(Input(name=role, role=role, range=RANGES.get(role)) for role in roles)
    return replace(manifest_of(4), inputs=inputs, **changes)


def post_process_manifest():
    """A manifest of a model that enhances a picture."""
    inputs = (Input(name="image", role="image"),)
    return PostProcessManifest(
        name="enhance", inputs=inputs, outputs=PostProcessOutputs(ImageOutput("output"))
    )


def sampled(manifest, **changes):
    """All probes but the one of zeros."""
    shapes = SHAPES | changes.pop("shapes", {})
    dtypes = DTYPES | changes.pop("dtypes", {})
    return default_probes(manifest, shapes, dtypes, **changes)[1:]


def values(role, manifest=None, **changes):
    probes = sampled(manifest or manifest_with_roles(role), **changes)
    return np.stack([probe.inputs[role] for probe in probes])


def test_a_model_without_inputs_has_one_probe():
    (probe,) = default_probes(manifest_with_roles(), {}, {})
    assert (probe.inputs, probe.zeros) == ({}, False)


def test_the_first_probe_is_all_zeros():
    first, *others = default_probes(manifest_with_roles(*SHAPES), SHAPES, DTYPES)
    assert first.zeros
    assert first.label == "all inputs zero"
    assert all(not array.any() for array in first.inputs.values())
    assert not any(probe.zeros for probe in others)


@pytest.mark.parametrize("count", [2, 3, 8])
def test_every_probe_feeds_every_input_in_its_shape_and_dtype(count):
    probes = default_probes(manifest_with_roles(*SHAPES), SHAPES, DTYPES, count=count)
    assert len(probes) == 1 + count
    for probe in probes:
        assert {name: array.shape for name, array in probe.inputs.items()} == SHAPES
        assert {name: str(array.dtype) for name, array in probe.inputs.items()} == DTYPES
        assert all(np.isfinite(array).all() for array in probe.inputs.values())


def test_the_same_seed_gives_the_same_probes_and_another_gives_others():
    first_probes, again, other = (
        sampled(manifest_with_roles(*SHAPES), seed=seed) for seed in (0, 0, 1)
    )
    for a, b, c in zip(first_probes, again, other, strict=True):
        assert a.label == b.label
        for name in SHAPES:
            np.testing.assert_array_equal(a.inputs[name], b.inputs[name])
        assert (a.inputs["pose"] != c.inputs["pose"]).any()


def test_times_cover_the_range_with_both_ends():
    np.testing.assert_allclose(values("time")[:, 0], np.linspace(2, 3, 8), rtol=1e-6)


def test_indices_are_whole_and_reach_both_ends():
    assert values("frame_index")[:, 0].tolist() == [0, 8, 17, 25, 34, 42, 51, 59]
    assert set(values("appearance_id")[:, 0]) == {3, 4}


@pytest.mark.parametrize(
    ("role", "low", "high"),
    [("shape", -2, 2), ("control", 5, 6), ("pose", -0.6, 0.6), ("root_translation", -0.5, 0.5)],
)
def test_other_inputs_are_spread_over_their_range(role, low, high):
    actual = values(role)
    assert ((actual >= low) & (actual <= high)).all()
    assert actual.max() - actual.min() > 0.5 * (high - low)


def test_quaternions_are_unit():
    actual = values("pose", shapes={"pose": (24, 4)})
    np.testing.assert_allclose(np.linalg.norm(actual, axis=-1), 1, rtol=1e-6)


def test_rotation_matrices_are_proper():
    actual = values("root_rotation")
    np.testing.assert_allclose(actual @ actual.transpose(0, 2, 1), [np.eye(3)] * 8, atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(actual), 1, rtol=1e-5)


BOUNDS = Bounds((1.0, 2.0, 3.0), (5.0, 6.0, 7.0))
CENTER = np.array([3.0, 4.0, 5.0])


@pytest.mark.parametrize("up", ["-y", "+y", "+z", "-z", "+x", "-x"])
def test_cameras_look_at_the_bounds_from_outside_with_up_on_top(up):
    manifest = manifest_with_roles("view", bounds=BOUNDS, space=Space(up=up))
    axis = np.zeros(3)
    axis["xyz".index(up[1])] = 1 if up[0] == "+" else -1
    eyes = []
    for tensor in values("view", manifest):
        view = tensor.T.astype(np.float64)  # column order is the default
        x, y, z = (view @ [*CENTER, 1])[:3]
        np.testing.assert_allclose([x, y], 0, atol=1e-5)
        assert z > np.linalg.norm([4, 4, 4]) / 2
        assert (view[:3, :3] @ axis)[1] < 0  # y points down
        eyes.append(-view[:3, :3].T @ view[:3, 3])
    spread = np.ptp(np.stack(eyes), axis=0)
    assert (spread > 4).all()


def test_the_camera_position_is_the_eye_of_the_view():
    manifest = manifest_with_roles("view", "camera_position", bounds=BOUNDS)
    for probe in sampled(manifest):
        view = probe.inputs["view"].T
        eye = -view[:3, :3].T @ view[:3, 3]
        np.testing.assert_allclose(probe.inputs["camera_position"], eye, rtol=1e-5)


def test_matrices_are_laid_out_in_the_declared_order():
    column, row = (
        manifest_with_roles("view", space=Space(matrix_order=order)) for order in ("column", "row")
    )
    np.testing.assert_array_equal(values("view", column), values("view", row).transpose(0, 2, 1))


@pytest.mark.parametrize(("order", "last_row"), [("row", [0, 0, 0, 1]), ("column", [1, 2, 3, 1])])
def test_column_order_holds_the_transpose(order, last_row):
    matrix = look_at(np.zeros(3), np.array([0.0, 0, 1]), np.array([0.0, -1, 0]))
    matrix[:3, 3] = [1, 2, 3]
    result = as_tensor(matrix, order)
    assert result[3].tolist() == last_row
    assert result.dtype == np.float32
    assert result.flags.c_contiguous


def test_images_and_lenses_differ_between_probes_and_fit_each_other():
    probes = sampled(manifest_with_roles("projection", "viewport"))
    for probe in probes:
        width, height = probe.inputs["viewport"]
        lens = probe.inputs["projection"].T
        assert -lens[1, 1] / lens[0, 0] == pytest.approx(width / height, rel=1e-5)
    assert len({probe.inputs["projection"].tobytes() for probe in probes}) == len(probes)


@pytest.mark.parametrize("extent", [1e30, 1e300, 1.7e308])
def test_bounds_without_measure_give_finite_cameras(extent):
    bounds = Bounds((-extent,) * 3, (extent,) * 3)
    manifest = manifest_with_roles("view", "camera_position", bounds=bounds)
    assert all(np.isfinite(a).all() for probe in sampled(manifest) for a in probe.inputs.values())


@pytest.mark.parametrize("extent", [1e10, 1e100, 1.7e308])
@pytest.mark.parametrize("role", ["time", "frame_index", "control"])
def test_ranges_without_measure_give_finite_inputs(role, extent):
    manifest = replace(
        manifest_of(4), inputs=(Input(name=role, role=role, range=(-extent, extent)),)
    )
    actual = values(role, manifest)
    assert np.isfinite(actual).all()
    assert actual.min() < 0 < actual.max()


def test_bounds_that_are_a_point_give_a_camera():
    assert np.isfinite(
        values("view", manifest_with_roles("view", bounds=Bounds((1.0,) * 3, (1.0,) * 3)))
    ).all()


def test_a_manifest_of_another_kind_has_probes_too():
    manifest = TrajectoryManifest(
        name="next",
        inputs=(Input(name="past", role="camera_history"),),
        outputs=TrajectoryOutputs(
            FutureOutput("future", 3, "position+axis-angle"), UncertaintyOutput("doubt")
        ),
        step_seconds=0.1,
    )
    probes = default_probes(manifest, {"past": (5, 6)}, {"past": "float32"}, count=2)
    assert [probe.label for probe in probes] == ["all inputs zero", "sample 0", "sample 1"]


def test_a_label_says_which_camera_and_the_value_of_every_number():
    labels = [
        probe.label for probe in sampled(manifest_with_roles("view", "time", "shape"), count=3)
    ]
    assert labels == ["camera 0, time=2", "camera 1, time=2.5", "camera 2, time=3"]


def test_dependency_probes_change_the_inputs_of_one_role_alone():
    inputs = (
        Input(name="view", role="view"),
        Input(name="a", role="control"),
        Input(name="b", role="control"),
    )
    manifest = replace(manifest_of(4), inputs=inputs)
    shapes = {"view": (4, 4), "a": (1,), "b": (1,)}
    probes = default_probes(manifest, shapes, dict.fromkeys(shapes, "float32"))
    base, others = probes[1], probes[2:4]
    result = dict(dependency_probes(manifest, base, others))
    assert list(result) == ["control", "view"]
    for role, changed in {"control": {"a", "b"}, "view": {"view"}}.items():
        for variant, other in zip(result[role], others, strict=True):
            assert variant.label == f"{base.label} with the {role} of {other.label}"
            for name in shapes:
                source = other if name in changed else base
                assert variant.inputs[name] is source.inputs[name]


def test_pictures_fill_their_range_and_their_spectrum_falls():
    size = 64
    pictures = values("image", shapes={"image": (2, 3, size, size)})
    assert np.abs(pictures).max() <= 1
    assert (pictures.max(axis=(2, 3, 4)) - pictures.min(axis=(2, 3, 4)) > 0.8).all()
    assert np.ptp(pictures.reshape(len(pictures), -1), axis=0).min() > 0.05
    energy = np.abs(np.fft.fft2(pictures - pictures.mean(axis=(3, 4), keepdims=True))) ** 2
    frequencies = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(size, 1 / size)]))
    bands = [
        energy[..., (frequencies >= low) & (frequencies < 2 * low)].sum() for low in (0.7, 2.8, 11)
    ]
    assert bands[0] > 2 * bands[1] > 4 * bands[2]


def test_pictures_of_a_post_process_model_are_noise_as_before():
    manifest = post_process_manifest()
    (probe, *_) = sampled(manifest, shapes={"image": (1, 3, 16, 16)})
    expected = np.random.default_rng([0, 0]).random((1, 3, 16, 16)).astype(np.float32)
    np.testing.assert_array_equal(probe.inputs["image"], expected)


@pytest.mark.parametrize("order", ["column", "row"])
def test_cameras_of_pictures_look_at_the_origin_whatever_the_bounds(order):
    bounds = Bounds((90.0, 90.0, 90.0), (110.0, 110.0, 110.0))
    roles = ("image", "image_view", "image_intrinsics")
    manifest = manifest_with_roles(*roles, bounds=bounds, space=Space(matrix_order=order))
    for probe in sampled(manifest):
        views = probe.inputs["image_view"].astype(np.float64)
        matrices = views.swapaxes(1, 2) if order == "column" else views
        rotations, translations = matrices[:, :3, :3], matrices[:, :3, 3]
        np.testing.assert_allclose(
            rotations @ rotations.swapaxes(1, 2), np.tile(np.eye(3), (2, 1, 1)), atol=1e-6
        )
        np.testing.assert_allclose(translations[:, :2], 0, atol=1e-5)
        assert (translations[:, 2] > 3).all()
        assert np.abs(rotations[0] - rotations[1]).max() > 0.1
        for matrix in probe.inputs["image_intrinsics"]:
            assert matrix[0, 0] == matrix[1, 1] > 0
            assert matrix[:2, 2].tolist() == [6, 4]
            assert matrix[2].tolist() == [0, 0, 1]
