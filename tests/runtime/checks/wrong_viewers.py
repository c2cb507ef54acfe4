"""A viewer that draws the kit with a renderer, and the faults that perturb its data before."""

__all__ = ["WRONG_VIEWERS", "Viewer"]

import pickle
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from gsgen.conformance.viewer_kit.case import KitCamera, KitFrame, ViewerKitCase
from gsgen.conformance.viewer_kit.write import picture_name
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest import GeneratorManifest, Space
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.spec.srgb import srgb_of_linear
from gsgen.runtime import Camera, Scene, SplatData, SplatSet
from gsgen.runtime.checks.level import scene_of
from gsgen.runtime.checks.viewer_kit import on_screen, runtime_camera
from gsgen.runtime.oracle import projection
from gsgen.runtime.oracle import render as oracle
from gsgen.sdk.binding import FrameSession
from gsgen.sdk.binding.camera_inputs import camera_values

Arrays = dict[str, np.ndarray]
Render = Callable[[Scene, Camera], np.ndarray]

_COMPUTED: dict[tuple[Path, bytes], list[Arrays]] = {}


@cache
def _declared(model: Path) -> GeneratorManifest:
    """Return the manifest in a model."""
    manifest = loads(open_model(model).manifest_text or "")
    assert isinstance(manifest, GeneratorManifest)
    return manifest


def _computed(
    model: Path, manifest: GeneratorManifest, feeds: Sequence[Mapping[str, Any]]
) -> list[Arrays]:
    """Return the outputs of a model for each frame; most viewers feed most models alike."""
    key = model, pickle.dumps((manifest, feeds))
    if key not in _COMPUTED:
        with FrameSession(model, provider="cpu", manifest=manifest) as session:
            runs = (session.run(values, copy=True) for values in feeds)
            _COMPUTED[key] = [{name: _kept(run[name]) for name in run} for run in runs]
    return _COMPUTED[key]


def _kept(values: Any) -> np.ndarray:
    """Return a copy that no viewer can write into."""
    array = np.array(values)
    array.flags.writeable = False
    return array


class Viewer:
    """Draws a case frame by frame; a fault overrides one of the steps."""

    def manifest(self, manifest: GeneratorManifest) -> GeneratorManifest:
        """Return the manifest as the viewer reads it."""
        return manifest

    def values(self, manifest: GeneratorManifest, values: Mapping[str, Any]) -> dict[str, Any]:
        """Return the values that the viewer feeds besides those of the camera."""
        return dict(values)

    def fed(self, manifest: GeneratorManifest, values: dict[str, Any]) -> dict[str, Any]:
        """Return the values of all inputs, those of the camera by name."""
        return values

    def outputs(self, manifest: GeneratorManifest, outputs: Arrays, first: Arrays) -> Arrays:
        """Return the outputs that the viewer reads; ``first`` are those of the first frame."""
        return outputs

    def camera(self, camera: KitCamera) -> KitCamera:
        """Return the camera that the viewer draws with."""
        return camera

    def screen(self, rgba: np.ndarray, scene: Scene) -> np.ndarray:
        """Return what the viewer's screen shows."""
        return on_screen(rgba, scene)

    def draw(self, model: Path, case: ViewerKitCase, render: Render, folder: Path) -> None:
        """Write the pictures of a case to ``folder``."""
        declared = _declared(model)
        manifest = self.manifest(declared)
        feeds = [self._feeds(declared, manifest, frame) for frame in case.frames]
        computed = _computed(model, manifest, feeds)
        for number, (frame, outputs) in enumerate(zip(case.frames, computed, strict=True)):
            read = self.outputs(declared, outputs, computed[0])
            scene = scene_of(manifest, read)
            rgba = render(scene, runtime_camera(self.camera(frame.camera)))
            name = picture_name(case.name, number)
            np.save(folder / f"{name}.npy", self.screen(rgba, scene).astype(np.float32))

    def _feeds(
        self, declared: GeneratorManifest, manifest: GeneratorManifest, frame: KitFrame
    ) -> dict[str, Any]:
        values = self.values(declared, frame.values)
        return self.fed(manifest, {**self._camera_values(manifest, frame), **values})

    def _camera_values(self, manifest: GeneratorManifest, frame: KitFrame) -> dict[str, Any]:
        known = camera_values(runtime_camera(frame.camera))
        return {entry.name: known[entry.role] for entry in manifest.inputs if entry.role in known}


class _ReadsManifest(Viewer):
    """Reads some fields of the manifest wrongly."""

    def __init__(self, edit: Callable[[GeneratorManifest], GeneratorManifest]) -> None:
        self._edit = edit

    def manifest(self, manifest: GeneratorManifest) -> GeneratorManifest:
        return self._edit(manifest)


class _ReadsRows(Viewer):
    """Reads an output wrongly."""

    def __init__(self, field: str, edit: Callable[[np.ndarray], np.ndarray]) -> None:
        self._field, self._edit = field, edit

    def outputs(self, manifest: GeneratorManifest, outputs: Arrays, first: Arrays) -> Arrays:
        tensor = getattr(manifest.outputs, self._field)
        if self._field == "appearance" and tensor.space == "rgb":
            return outputs
        return {**outputs, tensor.name: self._edit(outputs[tensor.name])}


class _ReadsRgb(Viewer):
    """Reads RGB of four channels with a stride of three."""

    def outputs(self, manifest: GeneratorManifest, outputs: Arrays, first: Arrays) -> Arrays:
        tensor = manifest.outputs.appearance
        assert tensor is not None
        if tensor.space == "sh":
            return outputs
        flat = outputs[tensor.name].reshape(-1)
        rows = len(outputs[tensor.name])
        return {**outputs, tensor.name: flat[: 3 * rows].reshape(rows, 3)}


class _ReadsHalves(Viewer):
    """Reads float16 outputs as float32."""

    def outputs(self, manifest: GeneratorManifest, outputs: Arrays, first: Arrays) -> Arrays:
        return {name: _as_float32(array) for name, array in outputs.items()}


class _Counts(Viewer):
    """Draws all rows, or as many as in the first frame."""

    def __init__(self, *, first_only: bool) -> None:
        self._first_only = first_only

    def outputs(self, manifest: GeneratorManifest, outputs: Arrays, first: Arrays) -> Arrays:
        entry, rows = manifest.outputs.count, manifest.outputs.gaussians
        assert entry is not None
        assert rows is not None
        count = first[entry.name] if self._first_only else np.array([rows.capacity], np.int32)
        return {**outputs, entry.name: count}


class _KeepsFirst(Viewer):
    """Shows the outputs of the first frame for ever."""

    def outputs(self, manifest: GeneratorManifest, outputs: Arrays, first: Arrays) -> Arrays:
        return first


class _FindsByShape(Viewer):
    """Takes the first output of ten columns for the rows."""

    def outputs(self, manifest: GeneratorManifest, outputs: Arrays, first: Arrays) -> Arrays:
        rows = manifest.outputs.gaussians
        assert rows is not None
        match = next(a for a in outputs.values() if a.ndim == 2 and a.shape[1] == 10)
        return {**outputs, rows.name: match}


class _LosesWeights(Viewer):
    """Shows an empty screen where a model has weights in another file."""

    def draw(self, model: Path, case: ViewerKitCase, render: Render, folder: Path) -> None:
        def black(scene: Scene, camera: Camera) -> np.ndarray:
            return np.zeros((camera.height, camera.width, 4))

        super().draw(model, case, black if case.spec().external else render, folder)


class _ForgetsRole(Viewer):
    """Feeds no input of one role."""

    def __init__(self, role: str) -> None:
        self._role = role

    def fed(self, manifest: GeneratorManifest, values: dict[str, Any]) -> dict[str, Any]:
        unfed_inputs = {entry.name for entry in manifest.inputs if entry.role == self._role}
        return {name: value for name, value in values.items() if name not in unfed_inputs}


class _ForgetsDefaults(Viewer):
    """Feeds zeros where an input has no value."""

    def fed(self, manifest: GeneratorManifest, values: dict[str, Any]) -> dict[str, Any]:
        return {entry.name: 0.0 for entry in manifest.inputs if entry.name not in values} | values


class _ScalesTime(Viewer):
    """Feeds time from 0 to 1, whatever its range."""

    def values(self, manifest: GeneratorManifest, values: Mapping[str, Any]) -> dict[str, Any]:
        ranges = {e.name: e.range for e in manifest.inputs if e.role == "time" and e.range}
        shares = {name: (values[name] - low) / (high - low) for name, (low, high) in ranges.items()}
        return {**values, **shares}

    def manifest(self, manifest: GeneratorManifest) -> GeneratorManifest:
        inputs = (
            replace(entry, range=(0.0, 1.0), default=0.0) if entry.role == "time" else entry
            for entry in manifest.inputs
        )
        return replace(manifest, inputs=tuple(inputs))


class _CentresLens(Viewer):
    """Ignores the principal point, and draws square pixels."""

    def camera(self, camera: KitCamera) -> KitCamera:
        return replace(camera, cx=camera.width / 2, cy=camera.height / 2, fy=camera.fx)


class _CentresProjection(Viewer):
    """Feeds a projection whose principal point is in the middle."""

    def _camera_values(self, manifest: GeneratorManifest, frame: KitFrame) -> dict[str, Any]:
        lens = frame.camera
        centred = replace(lens, cx=lens.width / 2, cy=lens.height / 2)
        return super()._camera_values(manifest, replace(frame, camera=centred))


class _SwapsViewport(Viewer):
    """Feeds the height before the width."""

    def fed(self, manifest: GeneratorManifest, values: dict[str, Any]) -> dict[str, Any]:
        names = {entry.name for entry in manifest.inputs if entry.role == "viewport"}
        swapped = {name: np.asarray(values[name])[::-1] for name in names}
        return {**values, **swapped}


class _MirrorsBehind(Viewer):
    """Draws Gaussians behind the camera where their projection is."""

    def draw(self, model: Path, case: ViewerKitCase, render: Render, folder: Path) -> None:
        def mirrored(scene: Scene, camera: Camera) -> np.ndarray:
            (splat_set,) = scene.sets
            data = splat_set.data
            rows = np.array(data.rows, np.float32)
            view_depth = (rows[:, :3] @ camera.view[2, :3] + camera.view[2, 3]) < 0
            rows[view_depth, :3] = 2 * camera.eye - rows[view_depth, :3]
            moved = SplatData(
                *(rows, data.appearance.astype(np.float32), data.space),
                count=data.count,
                cells=data.cells,
                per_cell=data.per_cell,
            )
            return render(Scene([replace(splat_set, data=moved)], scene.color_space), camera)

        super().draw(model, case, mirrored, folder)


class _EncodesAlways(Viewer):
    """Encodes linear colours and sRGB colours alike."""

    def screen(self, rgba: np.ndarray, scene: Scene) -> np.ndarray:
        return srgb_of_linear(np.clip(rgba[..., :3], 0, 1))


class _DrawsThinly(Viewer):
    """Adds next to nothing to the projected covariances."""

    def draw(self, model: Path, case: ViewerKitCase, render: Render, folder: Path) -> None:
        def thin(scene: Scene, camera: Camera) -> np.ndarray:
            return render(scene, replace(camera, dilation=1e-6))

        super().draw(model, case, thin, folder)


class _EditsSplats(Viewer):
    """Draws with the float64 renderer, with another order or colour of the projected Gaussians."""

    def __init__(
        self, edit: Callable[[projection.Splats, SplatSet, Camera], dict[str, Any]]
    ) -> None:
        self._edit = edit

    def draw(self, model: Path, case: ViewerKitCase, render: Render, folder: Path) -> None:
        project = projection.drawn_splats

        def edited(splat_set: SplatSet, camera: Camera, *kwargs: Any) -> projection.Splats:
            splats = project(splat_set, camera, *kwargs)
            return replace(splats, **self._edit(splats, splat_set, camera))

        def drawn(scene: Scene, camera: Camera) -> np.ndarray:
            with patch.object(projection, "drawn_splats", edited):
                return np.asarray(oracle.render(scene, camera).rgba)

        super().draw(model, case, drawn, folder)


def _unsorted(splats: projection.Splats, _: SplatSet, __: Camera) -> dict[str, Any]:
    return {"depth": np.arange(1.0, len(splats.depth) + 1)}


def _by_distance(splats: projection.Splats, splat_set: SplatSet, camera: Camera) -> dict[str, Any]:
    offsets = splat_set.data.rows[splats.index, :3].astype(np.float64) - camera.eye
    return {"depth": np.linalg.norm(offsets, axis=1)}


def _unclamped(splats: projection.Splats, splat_set: SplatSet, camera: Camera) -> dict[str, Any]:
    return {"color": projection._colors(splat_set, camera)[splats.index]}


def _without_offset(color: np.ndarray) -> np.ndarray:
    constant = 0.5 / np.sqrt(np.pi)  # the harmonic of degree 0
    shifted = color.copy()
    shifted[:, :3] -= np.asarray(0.5 / constant, color.dtype)
    return shifted


def _as_float32(array: np.ndarray) -> np.ndarray:
    if array.dtype != np.float16:
        return array
    flat = np.nan_to_num(array.reshape(-1).copy().view(np.float32), posinf=0, neginf=0)
    return np.resize(np.append(flat, np.zeros(flat.size, np.float32)), array.shape)


def _by_channel(color: np.ndarray) -> np.ndarray:
    return color.reshape(len(color), 3, -1).transpose(0, 2, 1).reshape(color.shape)


def _stride_of_degree_3(color: np.ndarray) -> np.ndarray:
    flat = np.zeros(len(color) * 48, color.dtype)
    flat[: color.size] = color.reshape(-1)
    return flat.reshape(-1, 48)[:, : color.shape[1]]


def _opposite(color: np.ndarray) -> np.ndarray:
    """Negate the odd degrees, as the opposite direction does."""
    degree_of = np.repeat(np.arange(4), (1, 3, 5, 7))[: color.shape[1] // 3]
    sign = np.where(degree_of % 2, -1, 1).astype(color.dtype)
    signed = color.reshape(len(color), -1, 3) * sign[:, None]
    return np.asarray(signed.reshape(color.shape))


def _voigt(rows: np.ndarray) -> np.ndarray:
    return rows[:, [0, 1, 2, 3, 4, 7, 9, 5, 6, 8]]


def _order(manifest: GeneratorManifest, order: Any) -> GeneratorManifest:
    return replace(manifest, space=replace(manifest.space or Space(), matrix_order=order))


def _swapped(manifest: GeneratorManifest) -> GeneratorManifest:
    space = manifest.space or Space()
    return _order(manifest, "row" if space.matrix_order == "column" else "column")


def _shown_unencoded(manifest: GeneratorManifest) -> GeneratorManifest:
    assert manifest.outputs.appearance is not None
    appearance = replace(manifest.outputs.appearance, color_space="srgb")
    return replace(manifest, outputs=replace(manifest.outputs, appearance=appearance))


_ROLES = (
    *("view", "projection", "camera_position", "viewport", "time", "frame_index"),
    *("pose", "root_rotation", "root_translation", "shape", "expression"),
    *("appearance_id", "control", "image", "image_view", "image_intrinsics"),
)

WRONG_VIEWERS: dict[str, Viewer] = {
    "rows": _ReadsRows("gaussians", _voigt),
    "sh-order": _ReadsRows("appearance", _by_channel),
    "sh-stride": _ReadsRows("appearance", _stride_of_degree_3),
    "sh-direction": _ReadsRows("appearance", _opposite),
    "float16": _ReadsHalves(),
    "fourth-channel": _ReadsRgb(),
    "color-space": _ReadsManifest(_shown_unencoded),
    "antialias": _ReadsManifest(lambda manifest: replace(manifest, antialias="classic")),
    "count": _Counts(first_only=False),
    "stale-count": _Counts(first_only=True),
    "stale-outputs": _KeepsFirst(),
    "matrix-order": _ReadsManifest(_swapped),
    "matrix-order-ignored": _ReadsManifest(lambda manifest: _order(manifest, "column")),
    "intrinsics": _CentresLens(),
    "projection-centre": _CentresProjection(),
    "viewport-order": _SwapsViewport(),
    "dilation": _DrawsThinly(),
    "order": _EditsSplats(_unsorted),
    "order-distance": _EditsSplats(_by_distance),
    "encoded-twice": _EncodesAlways(),
    "sh-offset": _ReadsRows("appearance", _without_offset),
    "sh-clamp": _EditsSplats(_unclamped),
    "behind-camera": _MirrorsBehind(),
    "time-range": _ScalesTime(),
    "default": _ForgetsDefaults(),
    "weighted-sum": _ReadsManifest(
        lambda manifest: replace(manifest, blend="alpha", weighted_sum=None)
    ),
    "output-names": _FindsByShape(),
    "external-data": _LosesWeights(),
    **{f"role-{role}": _ForgetsRole(role) for role in _ROLES},
}
"""Fault id → the viewer that has it."""
