from dataclasses import replace

import numpy as np
import pytest

from gsgen.contract.probing.behaviour_probes import trial_probes
from gsgen.contract.probing.probes import Probe, as_tensor, default_probes
from gsgen.contract.spec.manifest import Input, Space
from support.models.small_models import manifest_of

VIEW = Input(name="view", role="view")
LENS = Input(name="lens", role="projection")
SHAPES = {"view": (4, 4), "lens": (4, 4), "time": (1,), "frame": (1,), "pose": (2, 3)}


def trials(*inputs, order="column"):
    manifest = replace(manifest_of(1), inputs=inputs, space=Space(matrix_order=order))
    dtypes = {entry.name: "int32" if entry.role == "frame_index" else "float32" for entry in inputs}
    first = default_probes(manifest, SHAPES, dtypes)
    return first[1], dict(trial_probes(manifest, first[1], first))


def values(probes: tuple[Probe, ...], name: str) -> list[float]:
    return [round(float(probe.inputs[name].reshape(-1)[0]), 6) for probe in probes]


@pytest.mark.parametrize("order", ["column", "row"])
def test_a_camera_is_moved_in_the_declared_order_and_in_the_other(order):
    base, result = trials(VIEW, order=order)
    still, moved, transposed = (probe.inputs["view"] for probe in result["moved"])
    np.testing.assert_array_equal(still, base.inputs["view"])
    step = as_tensor(moved - still, order)
    assert (step[:3, 3] > 0).all()
    assert np.count_nonzero(step) == 3
    np.testing.assert_allclose(transposed - still, (moved - still).T, atol=1e-6)


@pytest.mark.parametrize("order", ["column", "row"])
def test_a_flipped_projection_differs_in_row_1_alone(order):
    _, result = trials(LENS, order=order)
    original, turned = (as_tensor(probe.inputs["lens"], order) for probe in result["flipped"])
    np.testing.assert_array_equal(turned[1], -original[1])
    np.testing.assert_array_equal(turned[[0, 2, 3]], original[[0, 2, 3]])


def test_edges_are_zeros_of_each_role_and_the_ends_of_all_ranges():
    time = Input(name="time", role="time", range=(2.0, 4.0))
    pose = Input(name="pose", role="pose", shape=(2, 3))
    _, result = trials(time, pose)
    assert values(result["edges"], "time")[0] == 0
    assert values(result["edges"], "pose")[1] == 0
    assert values(result["edges"], "time")[2:] == [2, 4]
    assert values(result["edges"], "pose")[2:] == [-3.141593, 3.141593]
    assert values(result["outside"], "time") == [1.98, 4.02]


def test_a_frame_number_never_leaves_its_range():
    _, result = trials(Input(name="frame", role="frame_index", range=(0.0, 7.0)))
    assert result["outside"] == ()


def test_a_loop_is_seen_at_its_seam():
    _, result = trials(Input(name="time", role="time", range=(0.0, 2.0), loop=True, frames=20))
    assert values(result["loop"], "time") == [0, 0.1, 1.9, 2]


def test_consecutive_times_differ_by_a_sixtieth_of_a_second():
    _, result = trials(Input(name="time", role="time", range=(0.0, 1.0), frames=30, fps=30.0))
    times = values(result["paces"], "time")
    steps = np.subtract(times[1::2], times[::2])
    np.testing.assert_allclose(steps, 1 / 60, atol=1e-5)


@pytest.mark.parametrize(("frames", "count"), [(1, 0), (2, 2), (12, 6), (64, 6), (500, 6)])
def test_times_within_some_frames_are_probed(frames, count):
    _, result = trials(Input(name="time", role="time", range=(0.0, 1.0), frames=frames))
    assert len(result["within frames"]) == count
    for probe in result["within frames"]:
        number = int(probe.label.split()[2])
        assert int(probe.inputs["time"][0] * frames) == number


def test_every_behaviour_run_is_extra_and_one_is_unoptimised():
    _, result = trials(VIEW, Input(name="time", role="time", range=(0.0, 1.0), loop=True))
    probes = [probe for group in result.values() for probe in group]
    assert all(probe.extra for probe in probes)
    assert [probe.optimise for probe in probes].count(False) == 1
    assert not probes[-1].optimise  # a session of its own comes last
