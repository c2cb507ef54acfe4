"""Draws a model's outputs as a viewer would, for validation rules that check drawn frames."""

__all__ = [
    "ComparedReference",
    "RenderEvidence",
    "RenderedProbe",
    "decibels",
    "prepare_render",
    "probe_camera",
    "scene_of",
]

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Final

import numpy as np

from gsgen.contract.probing.probes import ORBIT_RADII, Probe, as_tensor
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.tools.recording import evenly_spaced
from gsgen.contract.validation.level_backend import LevelContext, LevelUnavailable
from gsgen.runtime.checks.reference_image import (
    BACKGROUND,
    MAX_DECIBELS,
    MAX_REFERENCES,
    ReferenceUnreadable,
    image_decibels,
    read_reference,
    reference_camera,
)
from gsgen.runtime.errors import CapacityExceeded, DeviceUnavailable, SceneInvalid
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame, psnr
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.source import axis_direction

_PICTURE_WIDTH: Final = 640
_PICTURE_HEIGHT: Final = 360
_FRAME_COUNT: Final = 5
_AGREEMENT_RULE: Final = "GB020"
_REFERENCES_RULE: Final = "GB021"
_VERTICAL_FOV_DEGREES: Final = 50.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RenderedProbe:
    """The drawn frame of one run of a model with a set of test inputs (a probe).

    Attributes:
        probe: Label of the probe's inputs.
        live: Number of live rows.
        visible: Number of drawn Gaussians.
        coverage: The highest alpha of any pixel, in [0, 1].
        agreement: PSNR between both rasterisers in decibels; None if one cannot draw the frame.
    """

    probe: str
    live: int
    visible: int
    coverage: float
    agreement: float | None = None


@dataclass(frozen=True, slots=True)
class ComparedReference:
    """A reference image, compared with the frame that the model draws.

    Attributes:
        path: Path in the manifest.
        expected: The least peak signal-to-noise ratio, in decibels.
        psnr: The measured ratio; None if the picture cannot be compared.
        problem: The reason if it cannot; else empty.
    """

    path: str
    expected: float
    psnr: float | None = None
    problem: str = ""


@dataclass(frozen=True, slots=True)
class RenderEvidence:
    """The drawn frames of a model, which the validation rules of level ``render`` check."""

    frames: tuple[RenderedProbe, ...]
    device: str
    references: tuple[ComparedReference, ...] = ()


@contextmanager
def prepare_render(probe_runs: ProbeRuns) -> Iterator[LevelContext]:
    """Draw a model's outputs for some test inputs, for validation rules that check drawn frames."""
    if find_spec("wgpu") is None:
        raise LevelUnavailable("wgpu is not installed", hint="pip install 'gsgen[runtime]'")
    started = time.monotonic()
    try:
        renderer = Renderer(rasteriser="tiles")
        quad_renderer = _quad_renderer(renderer.device)
        frames = tuple(_render_probes(probe_runs, renderer, quad_renderer))
        references = tuple(_compare_references(probe_runs, renderer))
    except (DeviceUnavailable, CapacityExceeded) as error:
        message = f"{error.where}: {error.message}" if error.where else error.message
        raise LevelUnavailable(message, hint=error.hint) from error
    yield LevelContext(
        context=RenderEvidence(frames, renderer.device.name, references),
        items=len(frames),
        environment={"renderer": renderer.device.name},
        seconds=time.monotonic() - started,
        skipped=_skip_reasons(probe_runs, renderer.device),
    )


def _quad_renderer(device: Device) -> Renderer | None:
    """Return a renderer with the quad rasteriser, or None if the device does not support it."""
    return Renderer(device, rasteriser="quads") if device.blends_floats else None


def _skip_reasons(probe_runs: ProbeRuns, device: Device) -> dict[str, str]:
    """Return validation rules that cannot be checked for this model or device: id and reason."""
    manifest = probe_runs.subject.generator
    reasons = {}
    if manifest is not None and manifest.blend == "wsr":
        reasons[_AGREEMENT_RULE] = "weighted sums have one rasteriser only"
    elif not device.blends_floats:
        reasons[_AGREEMENT_RULE] = f"{device.name} cannot blend 32-bit floats, which quads need"
    if manifest is not None and manifest.reference_images and find_spec("PIL") is None:
        reasons[_REFERENCES_RULE] = "pillow is not installed"
    return reasons


def _render_probes(
    probe_runs: ProbeRuns, renderer: Renderer, quad_renderer: Renderer | None
) -> Iterator[RenderedProbe]:
    manifest = probe_runs.subject.generator
    assert manifest is not None  # the rules apply to generators only
    # All inputs zero would be an invalid camera.
    candidates = [n for n in range(probe_runs.plan.values) if not probe_runs.plan.probes[n].zeros]
    for number in evenly_spaced(candidates, min(len(candidates), _FRAME_COUNT)):
        probe = probe_runs.plan.probes[number]
        scene, camera = _probe_scene(probe_runs, number), probe_camera(manifest, probe)
        frame = renderer.render(scene, camera)
        agreement = None
        if quad_renderer is not None and scene.sets[0].weighted is None:
            agreement = decibels(frame, quad_renderer.render(scene, camera))
        yield RenderedProbe(
            probe=probe.label,
            live=scene.sets[0].data.count,
            visible=frame.visible,
            coverage=float(frame.alpha.max()),
            agreement=agreement,
        )


def _probe_scene(probe_runs: ProbeRuns, number: int) -> Scene:
    """Convert a model's outputs at a probe (a set of test inputs) to a scene."""
    manifest = probe_runs.subject.generator
    assert manifest is not None
    sample = probe_runs.execution.runs[number].sample
    return scene_of(manifest, probe_runs.execution.samples[sample].outputs)


def scene_of(manifest: GeneratorManifest, tensors: Mapping[str, np.ndarray]) -> Scene:
    """Convert the outputs of one run of an ONNX generator to a scene for the renderer.

    The manifest must declare gaussians and appearance.
    """
    outputs = manifest.outputs
    assert outputs.gaussians is not None
    assert outputs.appearance is not None
    rows = np.asarray(tensors[outputs.gaussians.name])
    count = len(rows)
    if outputs.count is not None:
        count = int(np.clip(tensors[outputs.count.name].reshape(-1)[0], 0, len(rows)))
    data = SplatData(
        rows,
        np.asarray(tensors[outputs.appearance.name]),
        outputs.appearance.space,
        count=count,
        cells=np.asarray(tensors[outputs.cells.name]) if outputs.cells else None,
        per_cell=outputs.cells.per_cell if outputs.cells else 1,
    )
    weighted = manifest.weighted_sum if manifest.blend == "wsr" else None
    splat_set = SplatSet(data, antialias=manifest.antialias, weighted=weighted)
    return Scene([splat_set], outputs.appearance.color_space)


def _compare_references(probe_runs: ProbeRuns, renderer: Renderer) -> Iterator[ComparedReference]:
    """Compare the reference images of the manifest with the frames that the model draws."""
    manifest = probe_runs.subject.generator
    if manifest is None or find_spec("PIL") is None:
        return
    probe_labels = [probe.label for probe in probe_runs.plan.probes[: probe_runs.plan.values]]
    for number, reference in enumerate(manifest.reference_images[: MAX_REFERENCES + 1]):
        ratio, problem = None, ""
        if number == MAX_REFERENCES:
            problem = f"only the first {MAX_REFERENCES} reference images are compared"
        elif reference.inputs not in probe_labels:
            problem = (
                f"no probe has the label {reference.inputs!r}, but {', '.join(probe_labels[:5])}, …"
            )
        else:
            try:
                expected = read_reference(probe_runs.subject.file.path, reference)
                height, width = expected.shape[:2]
                camera = reference_camera(reference, width, height)
            except (ReferenceUnreadable, SceneInvalid) as error:
                problem = str(error).partition("\n")[0]
            else:
                scene = _probe_scene(probe_runs, probe_labels.index(reference.inputs))
                frame = renderer.render(scene, camera, background=BACKGROUND)
                ratio = image_decibels(frame.srgb8, expected)
        yield ComparedReference(reference.path, reference.psnr, ratio, problem)


def decibels(a: Frame, b: Frame) -> float:
    """Return the peak signal-to-noise ratio between the colours of two frames, in decibels."""
    assert a.rgba is not None
    assert b.rgba is not None
    return min(psnr(a.rgba[..., :3], b.rgba[..., :3]), MAX_DECIBELS)


def probe_camera(manifest: GeneratorManifest, probe: Probe) -> Camera:
    """Return the camera in a set of test inputs, or else one that looks at the model's bounds."""
    inputs_by_role = {spec.role: probe.inputs[spec.name] for spec in manifest.inputs}
    order = manifest.space.matrix_order if manifest.space else "column"
    default_camera = _camera_at_bounds(manifest, inputs_by_role.get("camera_position"))
    if "view" not in inputs_by_role:
        return default_camera
    view = as_tensor(np.asarray(inputs_by_role["view"], np.float64), order).astype(np.float64)
    if "projection" not in inputs_by_role:
        return replace(default_camera, view=view)
    lens = as_tensor(np.asarray(inputs_by_role["projection"], np.float64), order).astype(np.float64)
    height = max(1, round(_PICTURE_WIDTH * lens[0, 0] / -lens[1, 1]))
    return Camera(
        view,
        fx=_PICTURE_WIDTH / 2 * float(lens[0, 0]),
        fy=height / 2 * float(-lens[1, 1]),
        cx=_PICTURE_WIDTH / 2 * float(lens[0, 2] + 1),
        cy=height / 2 * float(1 - lens[1, 2]),
        width=_PICTURE_WIDTH,
        height=height,
    )


def _camera_at_bounds(manifest: GeneratorManifest, eye: np.ndarray | None) -> Camera:
    """Return a camera that looks at a model's bounds, from ``eye`` or an orbit."""
    bounds = manifest.bounds
    low, high = (
        (np.array(bounds.min), np.array(bounds.max))
        if bounds is not None
        else (-np.ones(3), np.ones(3))
    )
    center, reach = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    up = axis_direction(manifest.space.up if manifest.space else "-y")
    if eye is None or np.allclose(eye, center):
        return Camera.orbit(
            center.tolist(),
            ORBIT_RADII * reach,
            azimuth=30,
            elevation=20,
            up=up,
            width=_PICTURE_WIDTH,
            height=_PICTURE_HEIGHT,
            fov_y=_VERTICAL_FOV_DEGREES,
        )
    return Camera.look_at(
        eye.reshape(-1).tolist(),
        center.tolist(),
        up=up,
        width=_PICTURE_WIDTH,
        height=_PICTURE_HEIGHT,
        fov_y=_VERTICAL_FOV_DEGREES,
    )
