"""Adds pictures rendered by a model's training code to a model copy, as its reference images.

They show what no number of a model can: swapped colour channels, a mirrored axis, other signs of
SH. A picture that the model itself drew would show the same fault as the model.
"""

__all__ = ["SourcePictures", "record_source_pictures"]

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, final

import numpy as np
from jaxtyping import UInt8

from gsgen.contract.errors import ConfigInvalid, InputUnreadable, UnknownName
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.probe_plan import fetched_outputs, make_plan
from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.fields.json_schema import to_json
from gsgen.contract.spec.fields.roles import CAMERA_ROLES
from gsgen.contract.spec.manifest import ReferenceImage
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
from gsgen.runtime.camera_files import CameraFile, open_cameras
from gsgen.runtime.checks.level import scene_of
from gsgen.runtime.checks.reference_image import (
    BACKGROUND,
    MAX_REFERENCES,
    MAX_SIDE,
    image_decibels,
)
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.media.pictures import png_of
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.natural_order import natural_key

if TYPE_CHECKING:
    from PIL.Image import Image

_PICTURE_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".webp")


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class SourcePictures:
    """The pictures of the training code that a model's copy declares as reference images.

    Attributes:
        model: The copy whose manifest declares them.
        images: Their declarations.
        decibels: How closely the model draws each of them, in the same order.
        names: File names of the pictures, in the same order.
        unmatched: File names of pictures without a camera.
        notes: Notes on the file of cameras, such as fields that are not used.
    """

    model: Path
    images: tuple[ReferenceImage, ...]
    decibels: tuple[float, ...]
    names: tuple[str, ...]
    unmatched: tuple[str, ...]
    notes: tuple[str, ...] = ()


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Source:
    """A picture that the training code rendered, with its camera."""

    name: str
    colors: UInt8[np.ndarray, "h w 3"]
    camera: Camera


def record_source_pictures(
    source: Path,
    model: Path,
    folder: Path,
    cameras: Path,
    *,
    probe: str | None = None,
    count: int | None = None,
    psnr: float = 35.0,
    settings: Settings | None = None,
    force: bool = False,
    renderer: Renderer | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> SourcePictures:
    """Add training-code pictures to a model's copy as references, and compare its frames with them.

    Args:
        source: A generator with a manifest; it stays as it is, unless ``model`` is the same file.
        model: The copy; its pictures go to the folder ``NAME-references`` next to it.
        folder: Pictures that the training code rendered, over black.
        cameras: A file of cameras in the model's space, whose names are those of the pictures.
        probe: Label of the probe whose inputs the pictures show; by default the first one.
        count: How many pictures, evenly spread, 16 at most; by default all, up to 16.
        psnr: The least decibels that the model must reach.
        settings: Limits of running the model.
        force: Replace existing pictures.
        renderer: Draws the model; a new one by default.
        progress: Called with a short text when a stage begins.

    Raises:
        ModelUnreadable: ``source`` is not an ONNX model.
        RecordingRefused: The model is not a generator, has no manifest, depends on the camera, or
            fails.
        InputUnreadable: The folder or a picture cannot be read.
        ConfigInvalid: No picture has a camera, the probe is unknown, or pictures exist already.
        DeviceUnavailable: No graphics device can be opened.
    """
    target = model.with_name(f"{model.stem}-references")
    recorded_pictures = sorted(target.glob("*.png"))
    if not force:
        refuse_existing(recorded_pictures, target, "copy")
    settings = settings or Settings()
    progress(f"reading {source.name}")
    subject = inspect_recordable(source, settings)
    chosen_probe = _find_probe(subject, settings, probe)
    camera_file = open_cameras(cameras)
    sources, unmatched = _match_cameras(folder, camera_file)
    selected = evenly_spaced(sources, min(count or len(sources), len(sources), MAX_REFERENCES))
    progress(f"drawing {len(selected)} pictures")
    decibels = _compare_pictures(
        subject, chosen_probe, selected, renderer or Renderer(rasteriser="tiles")
    )
    files = {
        f"{target.name}/{number}.png": png_of(entry.colors) for number, entry in enumerate(selected)
    }
    images = tuple(
        _declaration(path, file, entry.camera, chosen_probe.label, psnr)
        for (path, file), entry in zip(files.items(), selected, strict=True)
    )
    progress(f"writing {model.name}")
    changed = current_document(subject) | {"reference_images": to_json(images)}
    with write_recorded_copy(subject.file, changed, model) as draft_folder:
        (draft_folder / target.name).mkdir()
        for path, file in files.items():
            (draft_folder / path).write_bytes(file)
    for earlier_file in recorded_pictures:
        if f"{target.name}/{earlier_file.name}" not in files:
            earlier_file.unlink()
    return SourcePictures(
        model=model,
        images=images,
        decibels=decibels,
        names=tuple(entry.name for entry in selected),
        unmatched=unmatched,
        notes=camera_file.notes + _time_notes(camera_file, chosen_probe),
    )


def _time_notes(file: CameraFile, probe: Probe) -> tuple[str, ...]:
    """Return a note if cameras have times, which the one probe of all pictures replaces."""
    if all(entry.time is None for entry in file.cameras):
        return ()
    return (f"{file.path}: not used: the times; all pictures have the inputs of {probe.label!r}",)


def _find_probe(subject: InspectedModel, settings: Settings, label: str | None) -> Probe:
    """Return the test inputs called ``label``; raise if the outputs depend on the camera."""
    manifest, where = subject.generator, str(subject.file.path)
    if manifest is None:
        message = "is not a gaussian-generator; only generators have reference images"
        raise RecordingRefused(message, where=where)
    camera_inputs = [
        input_spec.name
        for input_spec in manifest.inputs
        if input_spec.role in CAMERA_ROLES and manifest.depends(input_spec)
    ]
    if camera_inputs:
        message = f"depends on the camera ({', '.join(camera_inputs)}), so no other camera's picture can be drawn"
        hint = "If only culling depends on it, declare a copy without the input."
        raise RecordingRefused(message, where=where, hint=hint)
    probes = make_plan(subject, Level.VALUES, settings.seed).probes
    probe_by_label = {entry.label: entry for entry in probes if not entry.zeros} or {
        entry.label: entry for entry in probes
    }
    if label is not None and label not in probe_by_label:
        raise UnknownName.among("probe", label, probe_by_label, "--probe")
    return probe_by_label[label or next(iter(probe_by_label))]


def _match_cameras(folder: Path, file: CameraFile) -> tuple[list[_Source], tuple[str, ...]]:
    """Return the training pictures that have a camera, and the names of those without a camera."""
    if not folder.is_dir():
        raise InputUnreadable("is not a folder, expected one of training images", where=str(folder))
    camera_by_stem = {Path(entry.name).stem: entry.camera for entry in file.cameras}
    paths = sorted(
        (path for path in folder.iterdir() if path.suffix.lower() in _PICTURE_SUFFIXES),
        key=lambda path: natural_key(path.name),
    )
    sources = [
        _read_source(path, camera_by_stem[path.stem])
        for path in paths
        if path.stem in camera_by_stem
    ]
    if not sources:
        names = ", ".join(list(camera_by_stem)[:3])
        message = f"holds {len(paths)} pictures, and none is named like a camera ({names}, …)"
        raise ConfigInvalid(message, where=str(folder))
    return sources, tuple(path.name for path in paths if path.stem not in camera_by_stem)


def _read_source(path: Path, camera: Camera) -> _Source:
    from PIL import Image, UnidentifiedImageError

    if camera.kind != "pinhole" or camera.distortion is not None:
        kind = camera.kind if camera.distortion is None else f"{camera.kind} with lens distortion"
        message = f"has a camera of kind {kind}, expected a pinhole without distortion"
        hint = "Undistort the pictures, and give the cameras of the undistorted pictures."
        raise SceneInvalid(message, where=str(path), hint=hint)
    try:
        with Image.open(path) as image:
            if max(image.size) > MAX_SIDE:
                size = f"{image.width}×{image.height} pixels"
                message = f"has {size}, expected at most {MAX_SIDE} a side"
                raise InputUnreadable(message, where=str(path))
            colors = _composite_over_black(image)
    except (Image.DecompressionBombError, UnidentifiedImageError, OSError) as error:
        raise InputUnreadable(f"is not a picture: {error}", where=str(path)) from error
    height, width = colors.shape[:2]
    if not camera.has_shape(width, height):
        message = f"has {width}×{height} pixels, but its camera {camera.width}×{camera.height}"
        raise InputUnreadable(message, where=str(path), hint="Name the cameras of these pictures.")
    return _Source(path.name, colors, camera.scaled(width, height))


def _composite_over_black(image: "Image") -> UInt8[np.ndarray, "h w 3"]:
    pixels = np.asarray(image.convert("RGBA"), np.float64)
    return np.asarray((pixels[..., :3] * pixels[..., 3:] / 255).round(), np.uint8)


def _compare_pictures(
    subject: InspectedModel, probe: Probe, sources: Sequence[_Source], renderer: Renderer
) -> tuple[float, ...]:
    """Draw the model from each picture's camera; return its PSNR against the picture, in dB."""
    manifest = subject.generator
    assert manifest is not None
    ratios = []
    with run_at_probes(subject, fetched_outputs(subject), [probe]) as execution:
        scene = scene_of(manifest, execution.samples[execution.runs[0].sample].outputs)
        for entry in sources:
            frame = renderer.render(scene, entry.camera, background=BACKGROUND)
            expected = (entry.colors / 255).astype(np.float32)
            ratios.append(image_decibels(frame.srgb8, expected))
    return tuple(ratios)


def _declaration(path: str, file: bytes, camera: Camera, label: str, psnr: float) -> ReferenceImage:
    rows = [tuple(float(value) for value in row) for row in camera.view[:3]]
    return ReferenceImage(
        path=path,
        sha256=hashlib.sha256(file).hexdigest(),
        inputs=label,
        view=tuple(rows),  # type: ignore[arg-type]  # four numbers each
        focal=(camera.fx, camera.fy),
        center=(camera.cx, camera.cy),
        psnr=psnr,
        from_="source",
    )
