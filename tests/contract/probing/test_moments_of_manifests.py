"""Named moments: frames begin where the specification says, defaults are fed, pictures vary."""

from dataclasses import replace

import numpy as np
import pytest

from gsgen.conformance.fixtures.valid.companions import post_process, trajectory
from gsgen.contract.probing.named_moments import FRAMES, moments_of
from gsgen.contract.probing.probes import default_probes
from gsgen.contract.spec.manifest import Input
from support.models.small_models import manifest_of


def moments(manifest, shapes, open_axes=None):
    first = default_probes(manifest, shapes, dict.fromkeys(shapes, "float32"))
    groups = {}
    for name, probe in moments_of(manifest, first, open_axes or {}, 100):
        groups.setdefault(name, []).append(probe)
    return groups


@pytest.mark.parametrize("frames", [1, 24, 500])
@pytest.mark.parametrize("span", [(0.0, 1.0), (2.0, 10.0)])
def test_every_frame_is_run_where_it_begins(frames, span):
    time = Input(name="time", role="time", range=span, frames=frames)
    probes = moments(replace(manifest_of(1), inputs=(time,)), {"time": (1,)})[FRAMES]
    expected = [span[0] + (span[1] - span[0]) * k / frames for k in range(frames)]
    np.testing.assert_array_equal(
        [probe.inputs["time"][0] for probe in probes], np.float32(expected)
    )
    assert [probe.label for probe in probes] == [f"frame {k}" for k in range(frames)]


@pytest.mark.parametrize("frames", [None, 65])
def test_every_frame_number_is_run(frames):
    entry = Input(name="frame", role="frame_index", range=(10.0, 74.0), frames=frames)
    shapes = {"frame": (1,)}
    manifest = replace(manifest_of(1), inputs=(entry,))
    first = default_probes(manifest, shapes, {"frame": "int32"})
    probes = [p for name, p in moments_of(manifest, first, {}, 9) if name == FRAMES]
    assert [int(probe.inputs["frame"][0]) for probe in probes] == list(range(10, 75))


def test_the_defaults_are_those_of_the_manifest():
    entries = (
        Input(name="view", role="view", default="identity"),
        Input(name="amount", role="control", range=(0.0, 4.0), default=3.0),
    )
    shapes = {"view": (4, 4), "amount": (1,)}
    plain, seen = moments(replace(manifest_of(1), inputs=entries), shapes)["defaults"]
    np.testing.assert_array_equal(plain.inputs["view"], np.eye(4))
    assert plain.inputs["amount"] == seen.inputs["amount"] == 3
    assert not np.array_equal(seen.inputs["view"], np.eye(4))


def test_open_sizes_are_multiples_of_few_powers_of_two():
    manifest = post_process.draw().manifest
    groups = moments(manifest, {"image": (1, 3, 64, 64)}, {2: 0, 3: 1})
    sizes = [probe.inputs["image"].shape[2:] for probe in groups["open sizes"]]
    for power in (8, 16, 64):
        assert any(height % power and width % power for height, width in sizes)
    patterns = {probe.label: probe.inputs["image"] for probe in groups["pictures"]}
    assert patterns["a black picture"].max() == 0
    assert patterns["a white picture"].min() == 1
    assert set(np.unique(patterns["a chequerboard"])) == {0, 1}


def test_histories_turn_through_half_a_turn_without_a_jump():
    manifest = trajectory.draw().manifest
    at, beyond = moments(manifest, {"past": (4, 7)})["histories"]
    for probe in (at, beyond):
        rotations = probe.inputs["past"][:, 3:].astype(np.float64)
        np.testing.assert_allclose(np.linalg.norm(rotations, axis=1), 1, atol=1e-6)
        assert ((rotations[1:] * rotations[:-1]).sum(axis=1) > 0.99).all()
    assert at.inputs["past"][-1, 3] == pytest.approx(0, abs=1e-6)
    assert beyond.inputs["past"][-1, 3] < 0
