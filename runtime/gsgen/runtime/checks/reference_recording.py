"""Record reference images: pictures that a model draws now, and must draw wherever it runs."""

__all__ = ["References", "record_references"]

import hashlib
import json
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.probe_plan import fetched_outputs, make_plan
from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.json_schema import to_json
from gsgen.contract.spec.layout import CULL_OPACITY
from gsgen.contract.spec.manifest import GeneratorManifest, ReferenceImage, Space
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.upgrades import upgrade
from gsgen.contract.tools.recording import (
    RecordingRefused,
    evenly_spaced,
    inspect_recordable,
    refuse_existing,
    run_at_probes,
    write_recorded_copy,
)
from gsgen.contract.validation.settings import Settings
from gsgen.runtime.checks.level import probe_camera, scene_of
from gsgen.runtime.checks.reference_image import BEHIND, MOST_REFERENCES
from gsgen.runtime.errors import SceneInvalid
from gsgen.runtime.media.pictures import png_of
from gsgen.runtime.playback.camera_options import viewpoint
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Frame
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.sources.scene_source import sources_of
from gsgen.runtime.sources.source import direction

_COUNT: Final = 3
_WIDTH: Final = 640
_SEEING: Final = ("view", "camera_position")
"""Roles of inputs that say from where a model is seen."""
_PICTURE: Final = re.compile(r"^[0-9]+\.png$")


@final
@dataclass(frozen=True, slots=True)
class References:
    """What was written.

    Attributes:
        model: The copy whose manifest declares the pictures.
        images: What it says of them now.
        empty: Labels of probes at which nothing is seen.
        device: What drew them.
    """

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
    """Draw ``source`` at some of its probes, and declare the pictures in the manifest of a copy.

    Args:
        source: A generator with a manifest; it stays as it is, unless ``model`` is the same file.
        model: The copy; its pictures go to a folder beside it, its name and ``-references``.
        camera: From where, in words of ``gsgen render --camera``; where absent, from where a
            probe says, or from where most of it is seen if the model knows of no camera.
        count: How many, spread over the probes that are not all zeros, 16 at most; three where
            absent, or all where there are fewer.
        width: Of the pictures, in pixels; 640 where absent. Heights follow from the cameras.
        psnr: The least decibels that a picture drawn elsewhere must have.
        settings: Limits of running the model.
        force: Replace pictures that stand there already.
        renderer: What draws; a new one where absent.
        progress: Called with a few words whenever a new stage begins.

    Raises:
        ModelUnreadable: ``source`` is not an ONNX model.
        RecordingRefused: It is no generator, has no manifest, breaks a static rule, or fails.
        ConfigInvalid: There are fewer probes, pictures stand there, nothing can be written, or
            the words mean no camera.
        DeviceUnavailable: There is nothing to draw with.
        GsgenError: It cannot be drawn.
    """
    folder = model.with_name(f"{model.stem}-references")
    standing = _standing(folder)
    if not force:
        refuse_existing(standing, folder, "copy")
    settings = settings or Settings()
    progress(f"reading {source.name}")
    subject = inspect_recordable(source, settings)
    if subject.generator is None:
        message = "is no gaussian-generator, and only these are drawn"
        raise RecordingRefused(message, where=str(source))
    probes = _chosen(make_plan(subject, Level.VALUES, settings.seed).probes, count)
    renderer = renderer or Renderer(rasteriser="tiles")
    views = _Views(subject.generator, camera, width or _WIDTH)
    shots = list(_drawn(subject, probes, views, renderer, progress))
    progress(f"writing {model.name}")
    images = _write(subject, shots, model, folder.name, psnr)
    for path in standing:
        if path.name not in {Path(image.path).name for image in images}:
            path.unlink()
    empty = [
        shot.probe.label for shot in shots if not shot.frame.alpha.max() >= CULL_OPACITY
    ]
    return References(model, images, tuple(empty), renderer.device.name)


@final
@dataclass(frozen=True, slots=True, eq=False)
class _Shot:
    """A probe, from where it was seen, and the picture."""

    probe: Probe
    camera: Camera
    frame: Frame


@final
class _Views:
    """From where a model is seen.

    Args:
        manifest: The model's.
        words: What a user typed; None where nothing was.
        width: Of the pictures, in pixels.
    """

    def __init__(self, manifest: GeneratorManifest, words: str | None, width: int) -> None:
        self._manifest, self._width = manifest, width
        seeing = any(spec.role in _SEEING for spec in manifest.inputs)
        self._view = None if seeing and words is None else viewpoint(words)

    def camera(self, probe: Probe, scene: Scene, number: int) -> Camera:
        """Return the camera of picture ``number``, from 0.

        Raises:
            SceneInvalid: A manifest cannot describe such a camera.
        """
        if self._view is None:
            camera = probe_camera(self._manifest, probe)
        else:
            (source,) = sources_of(scene)
            source.up = direction((self._manifest.space or Space()).up)
            camera = self._view.camera(source, number, 0.0)
        if camera.kind != "pinhole":
            message = (
                f"is a camera of kind {camera.kind}; reference images have perspective"
            )
            raise SceneInvalid(message, where="--camera")
        return camera.scaled(
            self._width, max(1, round(camera.height * self._width / camera.width))
        )


def _drawn(
    subject: InspectedModel,
    probes: Sequence[Probe],
    views: _Views,
    renderer: Renderer,
    progress: Callable[[str], None],
) -> Iterator[_Shot]:
    manifest = subject.generator
    assert manifest is not None
    progress(f"running {len(probes)} probes in ONNX Runtime")
    with run_at_probes(subject, fetched_outputs(subject), probes) as execution:
        for number, (run, probe) in enumerate(zip(execution.runs, probes, strict=True)):
            progress(f"drawing picture {number + 1} of {len(probes)}")
            scene = scene_of(manifest, execution.samples[run.sample].outputs)
            camera = views.camera(probe, scene, number)
            frame = renderer.render(scene, camera, background=BEHIND)
            yield _Shot(probe, camera, frame)


def _write(
    subject: InspectedModel, shots: Sequence[_Shot], model: Path, folder: str, psnr: float
) -> tuple[ReferenceImage, ...]:
    """Write the copy and its pictures; return what its manifest says of them."""
    assert subject.parsed is not None
    document = json.loads(subject.file.manifest_text or "{}")
    if subject.parsed.version is not None:  # 1.0 knows of no pictures
        document = upgrade(document, subject.parsed.version)
    files = {
        f"{folder}/{number}.png": png_of(shot.frame.srgb8[..., :3])
        for number, shot in enumerate(shots)
    }
    images = tuple(
        _declared(path, file, shot.probe, shot.camera, psnr)
        for (path, file), shot in zip(files.items(), shots, strict=True)
    )
    changed = document | {"reference_images": to_json(images)}
    with write_recorded_copy(subject.file, changed, model) as written:
        (written / folder).mkdir()
        for path, file in files.items():
            (written / path).write_bytes(file)
    return images


def _standing(folder: Path) -> list[Path]:
    """Return the pictures that a folder holds, in the order of their numbers."""
    if not folder.is_dir():
        return []
    pictures = [path for path in folder.iterdir() if _PICTURE.match(path.name)]
    return sorted(pictures, key=lambda path: int(path.stem))


def _chosen(probes: tuple[Probe, ...], count: int | None) -> list[Probe]:
    """Choose probes that are spread over those that have a camera; all zeros are none."""
    candidates = [probe for probe in probes if not probe.zeros] or list(probes)
    most = min(len(candidates), MOST_REFERENCES)
    if count is None:
        count = min(_COUNT, most)
    if not 1 <= count <= most:
        message = f"{count} pictures, wanted from 1 to {most}"
        raise ConfigInvalid(message, where="--count", hint=f"--count {most} takes most.")
    return evenly_spaced(candidates, count)


def _declared(
    path: str, file: bytes, probe: Probe, camera: Camera, psnr: float
) -> ReferenceImage:
    rows = [tuple(float(value) for value in row) for row in camera.view[:3]]
    return ReferenceImage(
        path=path,
        sha256=hashlib.sha256(file).hexdigest(),
        inputs=probe.label,
        view=tuple(rows),  # type: ignore[arg-type]  # four numbers each
        focal=(camera.fx, camera.fy),
        center=(camera.cx, camera.cy),
        psnr=psnr,
    )
