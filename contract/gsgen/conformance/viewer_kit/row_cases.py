"""Viewer tests of model outputs: layouts, dtypes, colours, row counts and weighted sums."""

__all__ = ["ROW_CASES"]

from dataclasses import replace

import numpy as np

from gsgen.conformance.fixtures.builders.clouds import Floats, still, summed
from gsgen.conformance.fixtures.builders.moving import drifting
from gsgen.conformance.fixtures.builders.scenes import Kind, pack, photographed, scene
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.conformance.fixtures.valid import still as valid
from gsgen.conformance.viewer_kit.case import (
    EVERY,
    EVERY_SH,
    KitCase,
    KitFrame,
    kit_camera,
    orbit_frame,
)
from gsgen.contract.spec.manifest import AppearanceOutput, WeightedSum

_ONE = (orbit_frame(),)
_TURNED = (KitFrame(camera=kit_camera((2.0, -1.2, 3.0))), orbit_frame())
_SH = (*EVERY, "sh-offset", "sh-order", "sh-direction")
_SH_SORTED = (*_SH, "sh-clamp", "order")
_SH_GAIN = 4.0  # colours that change enough with the direction to be seen


def _shown(kind: Kind, degree: int | None, dtype: Floats = "float32") -> ModelSpec:
    parts = scene(kind, 90)
    sh = parts.sh.copy()
    sh[:, 1:] *= _SH_GAIN
    return photographed(pack(replace(parts, sh=sh), degree), dtype)


def _four_channels() -> ModelSpec:
    model = still(40, degree=None)
    rgb = model.weights["colors"]
    padded = np.concatenate([rgb, np.full((len(rgb), 1), 0.25, np.float32)], axis=1)
    return model.reworded("[40,3]", "[40,4]").weighing(colors=padded)


def _linear() -> ModelSpec:
    appearance = AppearanceOutput("color", "rgb", None, "linear")
    return _shown("cloud", None).declaring_outputs(appearance=appearance)


def _mip() -> ModelSpec:
    model = _shown("cloud", 0)
    thin = np.array(model.weights["rows"])
    thin[:, 4:] *= 0.01
    return model.weighing(rows=thin).declaring(antialias="mip")


def _stale_rows() -> ModelSpec:
    """Return a model of twelve rows with a row count of five; later rows hold stale Gaussians."""
    return still(12).weighing(live=np.array([5], np.int32))


def _growing() -> ModelSpec:
    """Return a model of varying row count, whose rows after the count also hold Gaussians."""
    grown = drifting(8).reworded(
        "num_points = Identity (live)",
        "part = Mul (time, capacity) whole = Floor (part) num_points = Cast <to = 6> (whole)",
    )
    weights = {name: array for name, array in grown.weights.items() if name != "live"}
    return replace(grown, weights=weights).weighing(capacity=np.array([8], np.float32))


def _decoy() -> ModelSpec:
    """Return a model whose first output looks like Gaussians; its manifest names the second."""
    model = still(8)
    rows = model.weights["rows"]
    moved = np.array(rows)
    moved[:, :3] = -moved[:, 2::-1]
    widened = model.reworded("float[8,10] gaussians", "float[8,10] old, float[8,10] gaussians")
    return widened.reworded(
        "gaussians = Identity (rows)", "old = Identity (old_rows) gaussians = Identity (rows)"
    ).weighing(old_rows=moved)


def _weighted() -> ModelSpec:
    return summed(6, 4, degree=1).declaring(
        weighted_sum=WeightedSum(background=0.1, depth_range=6.0)
    )


ROW_CASES: tuple[KitCase, ...] = (
    KitCase(
        name="sh-degree-0",
        tests="One colour for each Gaussian, in three channels.",
        faults=(*EVERY_SH, "order"),
        spec=lambda: _shown("surface", 0),
        frames=_ONE,
    ),
    KitCase(
        name="sh-degree-1",
        tests="Twelve channels of SH, seen from two sides.",
        faults=(*_SH_SORTED, "sh-stride", "order-distance"),
        spec=lambda: _shown("surface", 1),
        frames=_TURNED,
    ),
    KitCase(
        name="sh-degree-2",
        tests="Twenty-seven channels of SH, seen from two sides.",
        faults=(*_SH_SORTED, "sh-stride"),
        spec=lambda: _shown("hair", 2),
        frames=_TURNED,
    ),
    KitCase(
        name="sh-degree-3",
        tests="Forty-eight channels of SH, seen from two sides.",
        faults=(*_SH_SORTED, "order-distance"),
        spec=lambda: _shown("surface", 3),
        frames=_TURNED,
    ),
    KitCase(
        name="sh-float16",
        tests="Rows and SH of degree 3 in float16.",
        faults=(*_SH_SORTED, "float16", "order-distance"),
        spec=lambda: _shown("avatar", 3, "float16"),
        frames=_TURNED,
    ),
    KitCase(
        name="rgb",
        tests="Raw RGB of three channels, without harmonics.",
        faults=(*EVERY, "order"),
        spec=lambda: _shown("cloud", None),
        frames=_ONE,
    ),
    KitCase(
        name="rgb-four-channels",
        tests="Raw RGB with a fourth channel that has no meaning.",
        faults=(*EVERY, "fourth-channel", "order", "order-distance"),
        spec=_four_channels,
        frames=_ONE,
    ),
    KitCase(
        name="rgb-float16",
        tests="Raw RGB in float16, padded to four channels.",
        faults=(*EVERY, "float16", "fourth-channel", "order"),
        spec=lambda: _shown("cloud", None, "float16"),
        frames=_ONE,
    ),
    KitCase(
        name="linear-color",
        tests="Colours in linear light, which the screen shows encoded as sRGB.",
        faults=("rows", "dilation", "color-space", "order"),
        spec=_linear,
        frames=_ONE,
    ),
    KitCase(
        name="antialias-mip",
        tests="Gaussians thinner than a pixel, which antialiasing makes fainter.",
        faults=(*EVERY_SH, "antialias"),
        spec=_mip,
        frames=_ONE,
    ),
    KitCase(
        name="one-gaussian",
        tests="A capacity of one row.",
        faults=(*EVERY, "sh-offset"),
        spec=lambda: still(1),
        frames=(KitFrame(camera=kit_camera((0.6, -0.4, -1.2))),),
        slight=("dilation",),
    ),
    KitCase(
        name="three-hundred",
        tests="Three hundred rows, which do not fill whole workgroups.",
        faults=(*EVERY_SH, "order", "order-distance"),
        spec=lambda: still(300),
        frames=_ONE,
    ),
    KitCase(
        name="count-below-capacity",
        tests="Rows behind the count hold Gaussians that must not be drawn.",
        faults=(*EVERY_SH, "count"),
        spec=_stale_rows,
        frames=_ONE,
        breaks=("GV018",),
    ),
    KitCase(
        name="count-changes",
        tests="A count that differs from frame to frame and ends at 0, an empty picture.",
        faults=(*EVERY_SH, "count", "stale-count", "stale-outputs", "role-time"),
        spec=_growing,
        frames=tuple(orbit_frame(time=[time]) for time in (0.5, 1.0, 0.25, 0.0)),
        breaks=("GV018",),
    ),
    KitCase(
        name="output-names",
        tests="The first output of the graph has the shape of rows, but the manifest names another.",
        faults=(*EVERY_SH, "output-names"),
        spec=_decoy,
        frames=_ONE,
    ),
    KitCase(
        name="external-data",
        tests="Colours in a file beside the model.",
        faults=(*EVERY_SH, "external-data"),
        spec=valid.weights_beside.draw,
        frames=_ONE,
        slight=("dilation",),
    ),
    KitCase(
        name="weighted-sum",
        tests="Gaussians in cells, summed by weights instead of sorted.",
        faults=(*_SH, "sh-stride", "weighted-sum"),
        spec=_weighted,
        frames=_ONE,
    ),
)
"""The cases of outputs."""
