"""Draw a model's outputs as a viewer would: what the rules of level ``render`` look at."""

__all__ = [
    "Compared",
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
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Final

import numpy as np

from gsgen.contract.probing.probes import Probe, as_tensor
from gsgen.contract.probing.run_comparison import ProbeRuns
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.validation.level_backend import LevelContext, LevelUnavailable
from gsgen.runtime.checks.reference_image import (
    BEHIND,
    MOST_REFERENCES,
    ReferenceUnreadable,
    read_reference,
    reference_camera,
)
from gsgen.runtime.errors import CapacityExceeded, DeviceUnavailable, SceneInvalid
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.source import direction

_WIDTH: Final = 640
_HEIGHT: Final = 360
_FRAMES: Final = 5
_AGREEMENT: Final = "GB020"
_REFERENCES: Final = "GB021"
_LEAST_ERROR: Final = 1e-20  # equal pictures have 200 dB
_FOV_Y: Final = 50.0
_DISTANCE: Final = 2.2  # half diagonals of the bounds, as the probes' own cameras have it


@dataclass(frozen=True, slots=True)
class RenderedProbe:
    """One frame that was drawn.

    Attributes:
        probe: Label of its inputs.
        live: How many rows are live.
        visible: How many Gaussians were drawn.
        covered: The most that any pixel is covered, in [0, 1].
        agreement: Of the two rasterisers, in decibels; None where only one of them can draw it.
    """

    probe: str
    live: int
    visible: int
    covered: float
    agreement: float | None = None


@dataclass(frozen=True, slots=True)
class Compared:
    """A declared picture beside what the model draws.

    Attributes:
        path: As declared.
        expected: The least decibels.
        psnr: Those there are; None where nothing can be compared.
        problem: Why not; empty where it was.
    """

    path: str
    expected: float
    psnr: float | None = None
    problem: str = ""


@dataclass(frozen=True, slots=True)
class RenderEvidence:
    """The frames of a model, drawn.

    Attributes:
        frames: In the order of the probes.
        device: What drew them.
        references: The pictures that the manifest declares.
    """

    frames: tuple[RenderedProbe, ...]
    device: str
    references: tuple[Compared, ...] = ()


@contextmanager
def prepare_render(trial: ProbeRuns) -> Iterator[LevelContext]:
    """Draw what the model of ``trial`` gave for some of its probes.

    Raises:
        LevelUnavailable: A package, an adapter or its memory is missing here.
    """
    if find_spec("wgpu") is None:
        raise LevelUnavailable("wgpu is not installed", hint="pip install 'gsgen[runtime]'")
    started = time.monotonic()
    try:
        renderer = Renderer(rasteriser="tiles")
        quads = _quads(renderer.device)
        frames = tuple(_drawn(trial, renderer, quads))
        references = tuple(_compared(trial, renderer))
    except (DeviceUnavailable, CapacityExceeded) as error:
        message = f"{error.where}: {error.message}" if error.where else error.message
        raise LevelUnavailable(message, hint=error.hint) from error
    yield LevelContext(
        context=RenderEvidence(frames, renderer.device.name, references),
        items=len(frames),
        environment={"renderer": renderer.device.name},
        seconds=time.monotonic() - started,
        skipped=_unjudged(trial, renderer.device),
    )


def _quads(device: Device) -> Renderer | None:
    """Return a renderer that draws by quads, or None: the device has none."""
    return Renderer(device, rasteriser="quads") if device.blends_floats else None


def _unjudged(trial: ProbeRuns, device: Device) -> dict[str, str]:
    """Return which rules cannot be judged, and why."""
    manifest = trial.subject.generator
    reasons = {}
    if manifest is not None and manifest.blend == "wsr":
        reasons[_AGREEMENT] = "weighted sums have one way to be drawn"
    elif not device.blends_floats:
        reasons[_AGREEMENT] = (
            f"{device.name} cannot blend 32-bit floats, so it has no quads"
        )
    if manifest is not None and manifest.reference_images and find_spec("PIL") is None:
        reasons[_REFERENCES] = "pillow is not installed"
    return reasons


def _drawn(
    trial: ProbeRuns, renderer: Renderer, quads: Renderer | None
) -> Iterator[RenderedProbe]:
    manifest = trial.subject.generator
    assert manifest is not None  # the rules are of generators alone
    for number in _chosen(trial):
        probe = trial.plan.probes[number]
        scene, camera = _scene(trial, number), probe_camera(manifest, probe)
        frame = renderer.render(scene, camera)
        second = None
        if quads is not None and scene.sets[0].weighted is None:
            second = decibels(frame, quads.render(scene, camera))
        live, covered = scene.sets[0].data.count, float(frame.alpha.max())
        yield RenderedProbe(probe.label, live, frame.visible, covered, second)


def _scene(trial: ProbeRuns, number: int) -> Scene:
    """Return what the model gave for a probe."""
    manifest = trial.subject.generator
    assert manifest is not None
    sample = trial.execution.runs[number].sample
    return scene_of(manifest, trial.execution.samples[sample].outputs)


def scene_of(manifest: GeneratorManifest, tensors: Mapping[str, np.ndarray]) -> Scene:
    """Return what a run of a model gave as a scene.

    Args:
        manifest: What its outputs mean; gaussians and appearance are declared.
        tensors: Output name → what it held.
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


def _compared(trial: ProbeRuns, renderer: Renderer) -> Iterator[Compared]:
    """Compare the pictures that the manifest declares with what is drawn."""
    manifest = trial.subject.generator
    if manifest is None or find_spec("PIL") is None:
        return
    labels = [probe.label for probe in trial.plan.probes[: trial.plan.values]]
    for number, reference in enumerate(manifest.reference_images):
        if number >= MOST_REFERENCES:
            few = f"there are {MOST_REFERENCES} before it, the most that are looked at"
            yield Compared(reference.path, reference.psnr, problem=few)
            return
        if reference.inputs not in labels:
            known = f"no probe is called {reference.inputs!r}; there are {', '.join(labels[:5])}, …"
            yield Compared(reference.path, reference.psnr, problem=known)
            continue
        try:
            expected = read_reference(trial.subject.file.path.parent, reference)
            height, width = expected.shape[:2]
            camera = reference_camera(reference, width, height)
        except (ReferenceUnreadable, SceneInvalid) as error:
            yield Compared(
                reference.path, reference.psnr, problem=str(error).partition("\n")[0]
            )
            continue
        frame = renderer.render(
            _scene(trial, labels.index(reference.inputs)), camera, background=BEHIND
        )
        apart = np.square(frame.srgb8[..., :3] / 255 - expected.astype(np.float64)).mean()
        psnr = float(-10 * np.log10(max(apart, _LEAST_ERROR)))
        yield Compared(reference.path, reference.psnr, psnr)


def decibels(a: Frame, b: Frame) -> float:
    """Return how alike the colours of two frames are: the peak signal-to-noise ratio of 1, in dB."""
    assert a.rgba is not None
    assert b.rgba is not None
    error = np.square(a.rgba[..., :3].astype(np.float64) - b.rgba[..., :3]).mean()
    return float(-10 * np.log10(max(error, _LEAST_ERROR)))


def _chosen(trial: ProbeRuns) -> list[int]:
    """Choose runs that are spread over the probes; all inputs zero is no camera."""
    candidates = [
        number for number in range(trial.plan.values) if not trial.plan.probes[number].zeros
    ]
    return [
        candidates[i]
        for i in np.linspace(0, len(candidates) - 1, min(len(candidates), _FRAMES))
        .round()
        .astype(int)
    ]


def probe_camera(manifest: GeneratorManifest, probe: Probe) -> Camera:
    """Return the camera that the inputs describe, or one that looks at the bounds."""
    by_role = {spec.role: probe.inputs[spec.name] for spec in manifest.inputs}
    order = manifest.space.matrix_order if manifest.space else "column"
    default_camera = _looking(manifest, by_role.get("camera_position"))
    if "view" not in by_role:
        return default_camera
    view = as_tensor(np.asarray(by_role["view"], np.float64), order).astype(np.float64)
    if "projection" not in by_role:
        return Camera(
            view,
            fx=default_camera.fx,
            fy=default_camera.fy,
            cx=default_camera.cx,
            cy=default_camera.cy,
            width=default_camera.width,
            height=default_camera.height,
        )
    lens = as_tensor(np.asarray(by_role["projection"], np.float64), order).astype(
        np.float64
    )
    height = max(1, round(_WIDTH * lens[0, 0] / -lens[1, 1]))
    focal = _WIDTH / 2 * float(lens[0, 0])
    return Camera(
        view,
        fx=focal,
        fy=height / 2 * float(-lens[1, 1]),
        cx=_WIDTH / 2 * float(lens[0, 2] + 1),
        cy=height / 2 * float(1 - lens[1, 2]),
        width=_WIDTH,
        height=height,
    )


def _looking(manifest: GeneratorManifest, eye: np.ndarray | None) -> Camera:
    """Return a camera that looks at the middle of the bounds, from ``eye`` if it is given."""
    bounds = manifest.bounds
    low, high = (
        (np.array(bounds.min), np.array(bounds.max))
        if bounds is not None
        else (-np.ones(3), np.ones(3))
    )
    center, reach = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)
    up = direction(manifest.space.up if manifest.space else "-y")
    if eye is None or np.allclose(eye, center):
        return Camera.orbit(
            center.tolist(),
            _DISTANCE * reach,
            azimuth=30,
            elevation=20,
            up=up,
            width=_WIDTH,
            height=_HEIGHT,
            fov_y=_FOV_Y,
        )
    return Camera.look_at(
        eye.reshape(-1).tolist(),
        center.tolist(),
        up=up,
        width=_WIDTH,
        height=_HEIGHT,
        fov_y=_FOV_Y,
    )
