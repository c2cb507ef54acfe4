"""Draws reference images of a model, and declares them in the manifest of a copy."""

__all__ = ["References", "record_references"]

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.probe_plan import fetched_outputs, make_plan
from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.fields.json_schema import to_json
from gsgen.contract.spec.layout import CULL_OPACITY
from gsgen.contract.spec.manifest import GeneratorManifest, ReferenceImage, Space
from gsgen.contract.spec.severity import Level
from gsgen.contract.tools.recording import (
    RecordingRefused,
    current_document,
    evenly_spaced,
    inspect_recordable,
    refuse_existing,
    run_at_probes,
    write_recorded_copy,
)
from gsgen.contract.validation.settings import Settings
from gsgen.runtime.checks.level import probe_camera, scene_of
from gsgen.runtime.checks.reference_image import BACKGROUND, MAX_REFERENCES
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.media.pictures import png_of
from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.scene_source import sources_of
from gsgen.runtime.sources.source import axis_direction

_DEFAULT_COUNT: Final = 3
_DEFAULT_WIDTH: Final = 640  # pixels
_CAMERA_ROLES: Final = ("view", "camera_position")
"""Roles of inputs that hold a camera."""
_PICTURE_NAME: Final = re.compile(r"^[0-9]+\.png$")


@final
@dataclass(frozen=True, slots=True)
class References:
    """A model copy with reference images, and the labels of test inputs that draw nothing."""

    model: Path
    images: tuple[ReferenceImage, ...]
    empty: tuple[str, ...]
    device: str


def record_references(
    source: Path,
    model: Path,
    *,
    camera: str | None = None,
    count: int | None = None,
    width: int | None = None,
    psnr: float = 50.0,
    settings: Settings | None = None,
    force: bool = False,
    renderer: Renderer | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> References:
    """Draw a model for some test inputs, and declare the pictures in the manifest of a copy.

    Args:
        source: A generator with a manifest; it stays as it is, unless ``model`` is the same file.
        model: The copy; its pictures go to the folder ``NAME-references`` next to it.
        camera: A value of ``gsgen render --camera``; by default the camera of a probe, or an orbit
            around the model if it has no camera input.
        count: Number of pictures, spread over the probes that are not all zeros, 16 at most; by
            default three, or all if there are fewer.
        width: Width of the pictures in pixels, 640 by default; heights follow from the cameras.
        psnr: Least PSNR of a picture on another machine, in decibels.
        settings: Limits of running the model.
        force: Replace existing pictures.
        renderer: Draws the pictures; a new one by default.
        progress: Called with a few words when a stage begins.

    Raises:
        ModelUnreadable: ``source`` is not an ONNX model.
        RecordingRefused: The model is not a generator, has no manifest, breaks a static rule, or
            fails.
        ConfigInvalid: There are fewer probes, pictures exist already, the copy cannot be
            written, or the camera is invalid.
        DeviceUnavailable: No graphics device can be opened.
        GsgenError: The model cannot be drawn.
    """
    folder = model.with_name(f"{model.stem}-references")
    existing_pictures = _existing_pictures(folder)
    if not force:
        refuse_existing(existing_pictures, folder, "copy")
    settings = settings or Settings()
    progress(f"reading {source.name}")
    subject = inspect_recordable(source, settings)
    if subject.generator is None:
        message = "is not a gaussian-generator; only generators have reference images"
        raise RecordingRefused(message, where=str(source))
    probes = _evenly_spread_probes(make_plan(subject, Level.VALUES, settings.seed).probes, count)
    renderer = renderer or Renderer(rasteriser="tiles")
    cameras = _PictureCameras(subject.generator, camera, width or _DEFAULT_WIDTH)
    pictures = list(_draw(subject, probes, cameras, renderer, progress))
    progress(f"writing {model.name}")
    images = _write(subject, pictures, model, folder.name, psnr)
    for path in existing_pictures:
        if path.name not in {Path(image.path).name for image in images}:
            path.unlink()
    empty = [
        picture.probe.label for picture in pictures if not picture.frame.alpha.max() >= CULL_OPACITY
    ]
    return References(model, images, tuple(empty), renderer.device.name)


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Picture:
    """The drawn frame of a model at one probe (a set of test inputs), with the camera."""

    probe: Probe
    camera: Camera
    frame: Frame


@final
class _PictureCameras:
    """The cameras of a model's reference images: those of the test inputs, or ``--camera``."""

    def __init__(self, manifest: GeneratorManifest, camera: str | None, width: int) -> None:
        self._manifest, self._image_width = manifest, width
        has_camera_input = any(spec.role in _CAMERA_ROLES for spec in manifest.inputs)
        self._view = None if has_camera_input and camera is None else viewpoint(camera)

    def camera(self, probe: Probe, scene: Scene, number: int) -> Camera:
        """Return the camera of reference image ``number``, from 0."""
        if self._view is None:
            camera = probe_camera(self._manifest, probe)
        else:
            (source,) = sources_of(scene)
            source.up = axis_direction((self._manifest.space or Space()).up)
            camera = self._view.camera(source, number, 0.0)
        if camera.kind != "pinhole" or camera.distortion is not None:
            lens = "" if camera.distortion is None else " with lens distortion"
            message = f"is {camera.kind}{lens}, expected a pinhole camera without distortion"
            raise SceneInvalid(message, where="--camera")
        return camera.scaled(
            self._image_width, max(1, round(camera.height * self._image_width / camera.width))
        )


def _draw(
    subject: InspectedModel,
    probes: Sequence[Probe],
    cameras: _PictureCameras,
    renderer: Renderer,
    progress: Callable[[str], None],
) -> Iterator[_Picture]:
    manifest = subject.generator
    assert manifest is not None
    progress(f"running {len(probes)} probes in ONNX Runtime")
    with run_at_probes(subject, fetched_outputs(subject), probes) as execution:
        for number, (run, probe) in enumerate(zip(execution.runs, probes, strict=True)):
            progress(f"drawing picture {number + 1} of {len(probes)}")
            scene = scene_of(manifest, execution.samples[run.sample].outputs)
            camera = cameras.camera(probe, scene, number)
            frame = renderer.render(scene, camera, background=BACKGROUND)
            yield _Picture(probe, camera, frame)


def _write(
    subject: InspectedModel, pictures: Sequence[_Picture], model: Path, folder: str, psnr: float
) -> tuple[ReferenceImage, ...]:
    """Write a copy of a model and its reference images; return their manifest entries."""
    files = {
        f"{folder}/{number}.png": png_of(picture.frame.srgb8[..., :3])
        for number, picture in enumerate(pictures)
    }
    images = tuple(
        _declaration(path, file, picture, psnr)
        for (path, file), picture in zip(files.items(), pictures, strict=True)
    )
    changed = current_document(subject) | {"reference_images": to_json(images)}
    with write_recorded_copy(subject.file, changed, model) as draft_folder:
        (draft_folder / folder).mkdir()
        for path, file in files.items():
            (draft_folder / path).write_bytes(file)
    return images


def _existing_pictures(folder: Path) -> list[Path]:
    """Return the reference images in a folder, in the order of their numbers."""
    if not folder.is_dir():
        return []
    pictures = [path for path in folder.iterdir() if _PICTURE_NAME.match(path.name)]
    return sorted(pictures, key=lambda path: int(path.stem))


def _evenly_spread_probes(probes: tuple[Probe, ...], count: int | None) -> list[Probe]:
    """Choose evenly spread test inputs, except all-zero inputs, whose camera would be invalid."""
    candidates = [probe for probe in probes if not probe.zeros] or list(probes)
    limit = min(len(candidates), MAX_REFERENCES)
    if count is None:
        count = min(_DEFAULT_COUNT, limit)
    if not 1 <= count <= limit:
        message = f"is {count}, expected from 1 to {limit}"
        raise ConfigInvalid(message, where="--count", hint=f"The largest is --count {limit}.")
    return evenly_spaced(candidates, count)


def _declaration(path: str, file: bytes, picture: _Picture, psnr: float) -> ReferenceImage:
    camera = picture.camera
    rows = [tuple(float(value) for value in row) for row in camera.view[:3]]
    return ReferenceImage(
        path=path,
        sha256=hashlib.sha256(file).hexdigest(),
        inputs=picture.probe.label,
        view=tuple(rows),  # type: ignore[arg-type]  # four numbers each
        focal=(camera.fx, camera.fy),
        center=(camera.cx, camera.cy),
        psnr=psnr,
    )
