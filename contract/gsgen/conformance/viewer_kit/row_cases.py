"""Viewer tests of model outputs: layouts, dtypes, colours, row counts and weighted sums."""

__all__ = ["ROW_CASES"]

from dataclasses import replace

import numpy as np

from gsgen.conformance.fixtures.builders.clouds import Floats, still, weighted_sum_model
from gsgen.conformance.fixtures.builders.moving import drifting_model
from gsgen.conformance.fixtures.builders.scenes import Kind, model_of_gaussians, pack, scene
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.conformance.fixtures.valid import still as valid
from gsgen.conformance.viewer_kit.case import (
    COMMON_FAULTS,
    COMMON_SH_FAULTS,
    KitFrame,
    ViewerKitCase,
    kit_camera,
    orbit_frame,
)
from gsgen.contract.spec.manifest import AppearanceOutput, WeightedSum

_ORBIT_FRAME_ONLY = (orbit_frame(),)
_FAR_AND_ORBIT_FRAMES = (KitFrame(camera=kit_camera((2.0, -1.2, 3.0))), orbit_frame())
_SH_FAULTS = (*COMMON_FAULTS, "sh-offset", "sh-order", "sh-direction")
_SORTED_SH_FAULTS = (*_SH_FAULTS, "sh-clamp", "order")
_SH_AMPLIFICATION = 4.0  # colours that change enough with the direction to be seen


def _scene_model(kind: Kind, degree: int | None, dtype: Floats = "float32") -> ModelSpec:
    parts = scene(kind, 90)
    sh = parts.sh.copy()
    sh[:, 1:] *= _SH_AMPLIFICATION
    return model_of_gaussians(pack(replace(parts, sh=sh), degree), dtype)


def _four_channel_model() -> ModelSpec:
    model = still(40, degree=None)
    rgb = model.weights["colors"]
    padded_rgb = np.concatenate([rgb, np.full((len(rgb), 1), 0.25, np.float32)], axis=1)
    return model.replace_text("[40,3]", "[40,4]").with_weights(colors=padded_rgb)


def _linear_color_model() -> ModelSpec:
    appearance = AppearanceOutput("color", "rgb", None, "linear")
    return _scene_model("cloud", None).with_outputs(appearance=appearance)


def _antialiased_model() -> ModelSpec:
    model = _scene_model("cloud", 0)
    thin_rows = np.array(model.weights["rows"])
    thin_rows[:, 4:] *= 0.01
    return model.with_weights(rows=thin_rows).with_manifest(antialias="mip")


def _model_with_stale_rows() -> ModelSpec:
    """Return a model of twelve rows with a row count of five; later rows hold stale Gaussians."""
    return still(12).with_weights(live=np.array([5], np.int32))


def _growing_count_model() -> ModelSpec:
    """Return a model of varying row count, whose rows after the count also hold Gaussians."""
    growing_model = drifting_model(8).replace_text(
        "num_points = Identity (live)",
        "part = Mul (time, capacity) whole = Floor (part) num_points = Cast <to = 6> (whole)",
    )
    weights = {name: array for name, array in growing_model.weights.items() if name != "live"}
    return replace(growing_model, weights=weights).with_weights(capacity=np.array([8], np.float32))


def _decoy_output_model() -> ModelSpec:
    """Return a model whose first output looks like Gaussians; its manifest names the second."""
    model = still(8)
    rows = model.weights["rows"]
    reordered_rows = np.array(rows)
    reordered_rows[:, :3] = -reordered_rows[:, 2::-1]
    renamed_outputs = model.replace_text(
        "float[8,10] gaussians", "float[8,10] old, float[8,10] gaussians"
    )
    return renamed_outputs.replace_text(
        "gaussians = Identity (rows)", "old = Identity (old_rows) gaussians = Identity (rows)"
    ).with_weights(old_rows=reordered_rows)


def _weighted_sum_model() -> ModelSpec:
    return weighted_sum_model(6, 4, degree=1).with_manifest(
        weighted_sum=WeightedSum(background=0.1, depth_range=6.0)
    )


ROW_CASES: tuple[ViewerKitCase, ...] = (
    ViewerKitCase(
        name="sh-degree-0",
        tests="One colour for each Gaussian, in three channels.",
        faults=(*COMMON_SH_FAULTS, "order"),
        spec=lambda: _scene_model("surface", 0),
        frames=_ORBIT_FRAME_ONLY,
    ),
    ViewerKitCase(
        name="sh-degree-1",
        tests="Twelve channels of SH, seen from two sides.",
        faults=(*_SORTED_SH_FAULTS, "sh-stride", "order-distance"),
        spec=lambda: _scene_model("surface", 1),
        frames=_FAR_AND_ORBIT_FRAMES,
    ),
    ViewerKitCase(
        name="sh-degree-2",
        tests="Twenty-seven channels of SH, seen from two sides.",
        faults=(*_SORTED_SH_FAULTS, "sh-stride"),
        spec=lambda: _scene_model("hair", 2),
        frames=_FAR_AND_ORBIT_FRAMES,
    ),
    ViewerKitCase(
        name="sh-degree-3",
        tests="Forty-eight channels of SH, seen from two sides.",
        faults=(*_SORTED_SH_FAULTS, "order-distance"),
        spec=lambda: _scene_model("surface", 3),
        frames=_FAR_AND_ORBIT_FRAMES,
    ),
    ViewerKitCase(
        name="sh-float16",
        tests="Rows and SH of degree 3 in float16.",
        faults=(*_SORTED_SH_FAULTS, "float16", "order-distance"),
        spec=lambda: _scene_model("avatar", 3, "float16"),
        frames=_FAR_AND_ORBIT_FRAMES,
    ),
    ViewerKitCase(
        name="rgb",
        tests="Raw RGB of three channels, without harmonics.",
        faults=(*COMMON_FAULTS, "order"),
        spec=lambda: _scene_model("cloud", None),
        frames=_ORBIT_FRAME_ONLY,
    ),
    ViewerKitCase(
        name="rgb-four-channels",
        tests="Raw RGB with a fourth channel that has no meaning.",
        faults=(*COMMON_FAULTS, "fourth-channel", "order", "order-distance"),
        spec=_four_channel_model,
        frames=_ORBIT_FRAME_ONLY,
    ),
    ViewerKitCase(
        name="rgb-float16",
        tests="Raw RGB in float16, padded to four channels.",
        faults=(*COMMON_FAULTS, "float16", "fourth-channel", "order"),
        spec=lambda: _scene_model("cloud", None, "float16"),
        frames=_ORBIT_FRAME_ONLY,
    ),
    ViewerKitCase(
        name="linear-color",
        tests="Colours in linear light, which the screen shows encoded as sRGB.",
        faults=("rows", "dilation", "color-space", "order"),
        spec=_linear_color_model,
        frames=_ORBIT_FRAME_ONLY,
    ),
    ViewerKitCase(
        name="antialias-mip",
        tests="Gaussians thinner than a pixel, which antialiasing makes fainter.",
        faults=(*COMMON_SH_FAULTS, "antialias"),
        spec=_antialiased_model,
        frames=_ORBIT_FRAME_ONLY,
    ),
    ViewerKitCase(
        name="one-gaussian",
        tests="A capacity of one row.",
        faults=(*COMMON_FAULTS, "sh-offset"),
        spec=lambda: still(1),
        frames=(KitFrame(camera=kit_camera((0.6, -0.4, -1.2))),),
        slight=("dilation",),
    ),
    ViewerKitCase(
        name="three-hundred",
        tests="Three hundred rows, which do not fill whole workgroups.",
        faults=(*COMMON_SH_FAULTS, "order", "order-distance"),
        spec=lambda: still(300),
        frames=_ORBIT_FRAME_ONLY,
    ),
    ViewerKitCase(
        name="count-below-capacity",
        tests="Rows behind the count hold Gaussians that must not be drawn.",
        faults=(*COMMON_SH_FAULTS, "count"),
        spec=_model_with_stale_rows,
        frames=_ORBIT_FRAME_ONLY,
        breaks=("GV018",),
    ),
    ViewerKitCase(
        name="count-changes",
        tests="A count that differs from frame to frame and ends at 0, an empty picture.",
        faults=(*COMMON_SH_FAULTS, "count", "stale-count", "stale-outputs", "role-time"),
        spec=_growing_count_model,
        frames=tuple(orbit_frame(time=[time]) for time in (0.5, 1.0, 0.25, 0.0)),
        breaks=("GV018",),
    ),
    ViewerKitCase(
        name="output-names",
        tests="The first output of the graph has the shape of rows, but the manifest names another.",
        faults=(*COMMON_SH_FAULTS, "output-names"),
        spec=_decoy_output_model,
        frames=_ORBIT_FRAME_ONLY,
    ),
    ViewerKitCase(
        name="external-data",
        tests="Colours in a file beside the model.",
        faults=(*COMMON_SH_FAULTS, "external-data"),
        spec=valid.weights_beside.draw,
        frames=_ORBIT_FRAME_ONLY,
        slight=("dilation",),
    ),
    ViewerKitCase(
        name="weighted-sum",
        tests="Gaussians in cells, summed by weights instead of sorted.",
        faults=(*_SH_FAULTS, "sh-stride", "weighted-sum"),
        spec=_weighted_sum_model,
        frames=_ORBIT_FRAME_ONLY,
    ),
)
"""The cases of outputs."""
