"""Reads scene files: a ``scene.json`` that places models and meshes in one world."""

__all__ = [
    "SceneAnnotation",
    "SceneFile",
    "ScenePost",
    "is_scene_file",
    "locate_errors",
    "open_scene",
    "read_scene",
]

import json
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal, TypeVar, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import GsgenError
from gsgen.formats.shared.notices import warn_unused
from gsgen.formats.shared.origins import Origin
from gsgen.runtime.errors import SceneInvalid, SceneUnreadable
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.colors import color_of
from gsgen.runtime.scene.mesh import SHADINGS, Shading
from gsgen.runtime.scene.scene import Box
from gsgen.runtime.sources.key_frames import DEFAULT_FPS, Animation, KeyFrames, SceneSound, Span
from gsgen.runtime.sources.mesh_files import read_mesh
from gsgen.runtime.sources.mesh_source import MeshSource
from gsgen.runtime.sources.opening import open_source
from gsgen.runtime.sources.placed_source import DrawSettings, PlacedSource
from gsgen.runtime.sources.scene_fields import (
    Fields,
    fields_of,
    read_sound_entry,
    read_transform,
    refuse,
)
from gsgen.runtime.sources.segmented_source import Segment, SegmentedSource, read_segments
from gsgen.runtime.sources.source import Source
from gsgen.runtime.sources.stream_settings import StreamOpener

if TYPE_CHECKING:
    from gsgen.sdk.binding.confined.models import ConfinedModels

VERSION: Final = "1.0"
Result = TypeVar("Result")

_VERSION_FIELD: Final = "gsgen_scene"
_SCENE_FIELDS: Final = frozenset({_VERSION_FIELD, "models", "meshes"})
_CAMERA_FORMS: Final = "orbit:AZIMUTH,ELEVATION[,RADIUS] or look-at:EX,EY,EZ,TX,TY,TZ"
_FBX: Final = ".fbx"
_MAX_BYTES: Final = 64 << 20  # inputs such as poses may be in the file


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SceneModel:
    """A splat file or ONNX generator of a scene file, with its transform to world, [4, 4].

    Several files that follow each other in time have no path but segments, whose largest has
    ``capacity`` Gaussians.
    """

    path: Path | None
    segments: tuple[Segment, ...]
    capacity: int
    transform: Float[np.ndarray, "4 4"]
    settings: DrawSettings
    inputs: Mapping[str, np.ndarray]
    keys: Mapping[str, KeyFrames]
    where: str
    visible: bool = True

    @property
    def paths(self) -> list[Path]:
        """The files of the model: one, or those of all segments."""
        return [segment.path for segment in self.segments] if self.path is None else [self.path]


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SceneMesh:
    """A mesh that a scene file lists.

    Attributes:
        path: The file.
        transform: Its space → world, [4, 4].
        shading: None keeps the shading of the mesh file.
        where: Its location in the scene file.
        visible: Whether it is drawn.
        page_only: What pages alone draw of it, in words.
    """

    path: Path
    transform: Float[np.ndarray, "4 4"]
    shading: Shading | None
    where: str
    visible: bool = True
    page_only: tuple[str, ...] = ()


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SceneAnnotation:
    """A text at a point of the world, which pages show.

    Attributes:
        position: The point, [3].
        text: The text.
        normal: Where it looks: it is hidden from cameras behind it; None for all cameras.
        camera: The camera that a click takes: an orbit of 2 or 3 numbers, or an eye and a target.
    """

    position: Float[np.ndarray, "3"]
    text: str
    normal: Float[np.ndarray, "3"] | None
    camera: tuple[float, ...] | None


@final
@dataclass(frozen=True, slots=True, eq=False)
class ScenePost:
    """A post-process model of a scene file, with values and key frames of its inputs."""

    path: Path
    inputs: Mapping[str, np.ndarray]
    keys: Mapping[str, KeyFrames]
    where: str


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SceneFile:
    """The contents of a scene file; absent fields are None.

    Attributes:
        path: The file.
        models: Splat files and generators, in order.
        meshes: Mesh files, in order.
        posts: Post-process models that the picture goes through, in order.
        background: Red, green, blue and alpha behind the scene.
        camera: A value of ``--camera``, a camera, or key frames of an orbit (2 or 3 numbers) or of
            an eye and a target (6 numbers).
        width: Width of the image, in pixels.
        height: Height of the image, in pixels.
        fov: Vertical field of view, in degrees.
        up: Axis of the world that points up; it overrides that of the models.
        kind: ``pinhole``, ``orthographic`` or ``panorama``, if ``camera`` is no camera.
        span: The timeline; None if nothing has key frames and there is none.
        annotations: Texts at points of the world.
        sound: A recording that plays with the timeline.
    """

    path: Path
    models: tuple[SceneModel, ...]
    meshes: tuple[SceneMesh, ...]
    posts: tuple[ScenePost, ...] = ()
    background: tuple[float, float, float, float] | None = None
    camera: str | Camera | KeyFrames | None = None
    width: int | None = None
    height: int | None = None
    fov: float | None = None
    up: str = "-y"
    kind: Literal["pinhole", "orthographic", "panorama"] | None = None
    span: Span | None = None
    annotations: tuple[SceneAnnotation, ...] = ()
    sound: SceneSound | None = None


def is_scene_file(path: Path) -> bool:
    """Return whether a file is a scene file: JSON with a version, models or meshes."""
    if path.suffix.lower() != ".json" or not path.is_file():
        return False
    text = path.read_bytes()[:_MAX_BYTES]
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):  # reading it as a scene then explains the error
        return path.name == "scene.json" or any(
            f'"{name}"'.encode() in text for name in _SCENE_FIELDS
        )
    is_scene = isinstance(document, dict) and bool(_SCENE_FIELDS & document.keys())
    return is_scene or path.name == "scene.json"


def read_scene(path: str | Path) -> SceneFile:
    """Read and check a scene file, without opening the files that it names."""
    file = Path(path)
    fields = fields_of(_document(file), str(file))
    version = fields.text(_VERSION_FIELD)
    if version is not None and version.split(".")[0] != VERSION.split(".")[0]:
        fields.refuse(_VERSION_FIELD, f"is {version!r}, expected {VERSION}")
    models = tuple(_read_model_entry(part, file.parent) for part in fields.parts("models"))
    meshes = tuple(_read_mesh(part, file.parent) for part in fields.parts("meshes"))
    if not models and not meshes:
        hint = "Name a file in `models`."
        refuse("the scene file has neither models nor meshes", str(file), hint)
    posts = tuple(_read_post(part, file.parent) for part in fields.parts("posts"))
    camera = _camera(fields, file.parent)
    keyed = [keys for model in models for keys in model.keys.values()]
    lengths = [sum(segment.seconds for segment in model.segments) for model in models]
    keyed += [keys for post in posts for keys in post.keys.values()]
    keyed += [camera] if isinstance(camera, KeyFrames) else []
    scene_file = SceneFile(
        path=file,
        models=models,
        meshes=meshes,
        posts=posts,
        background=_background(fields),
        camera=camera,
        width=fields.side("width"),
        height=fields.side("height"),
        fov=_read_fov(fields),
        up=fields.choice("up", ("+x", "-x", "+y", "-y", "+z", "-z")) or "-y",
        kind=fields.choice("kind", ("pinhole", "orthographic", "panorama")),
        span=_span(fields, max([keys.times[-1] for keys in keyed] + lengths, default=0.0)),
        annotations=tuple(_read_annotation(part) for part in fields.parts("annotations")),
        sound=read_sound_entry(fields, file.parent),
    )
    fields.close()
    return scene_file


def open_scene(
    scene: SceneFile | str | Path,
    provider: str = "cpu",
    sizes: Mapping[Path, Mapping[str, int]] | None = None,
    stream: StreamOpener | None = None,
    confined: "ConfinedModels | None" = None,
    origin: Origin | None = None,
) -> list[Source]:
    """Open the visible files of a scene file: first each model, then each mesh.

    The sources are for a ``Player`` or a ``FrameSequence``; the caller closes them. A warning names
    what pages alone draw.

    Args:
        scene: The scene file, or its path.
        provider: ONNX Runtime's execution provider for generators.
        sizes: Path of a generator → symbol → size of an open dimension.
        stream: Opens tilesets, such as ``gsgen.tiles.open_stream``.
        confined: Runs generators in a child process with limits; None runs them in this process.
        origin: The point of splat files that float32 positions are relative to; see
            ``open_source``.

    Raises:
        SceneUnreadable: A file cannot be read.
        GsgenError: A model cannot be opened; the message names its location in the scene file.
    """
    scene_file = scene if isinstance(scene, SceneFile) else read_scene(scene)

    def open_file(path: Path) -> Source:
        return open_source(path, provider, (sizes or {}).get(path), stream, confined, origin)

    with ExitStack() as exit_stack:
        sources: list[Source] = []
        for model in (model for model in scene_file.models if model.visible):
            sources.append(_open_model(model, open_file, scene_file.span))
            exit_stack.callback(sources[-1].close)
        sources += [_open_mesh(mesh) for mesh in scene_file.meshes if _is_drawn(mesh)]
        if not sources:
            message = "nothing of the scene is drawn here"
            hint = "See it in a page: gsgen view --web"
            raise SceneInvalid(message, where=str(scene_file.path), hint=hint)
        exit_stack.pop_all()  # from here on the caller closes the sources
    if scene_file.annotations:
        warn_unused(scene_file.path, ["annotations, which pages alone show"])
    return sources


def _is_drawn(mesh: SceneMesh) -> bool:
    """Return whether a mesh is drawn here; warn of what pages alone draw of it."""
    if mesh.visible:
        warn_unused(mesh.path, [f"{part}, which pages alone draw" for part in mesh.page_only])
    return mesh.visible and mesh.path.suffix.lower() != _FBX


def _open_model(
    model: SceneModel, open_file: Callable[[Path], Source], span: Span | None
) -> Source:
    field = "segments" if model.path is None else "path"
    if any(map(is_scene_file, model.paths)):
        refuse("is a scene file, expected a splat file or a generator", f"{model.where}.{field}")
    opening: Callable[[], Source] = (
        partial(SegmentedSource, model.where, model.segments, model.capacity, open_file)
        if model.path is None
        else partial(open_file, model.path)
    )
    nested_fields = locate_errors(opening, f"{model.where}.{field}")
    try:
        return PlacedSource(
            nested_fields,
            model.transform,
            model.settings,
            model.inputs,
            f"{model.where}.inputs",
            None if span is None else Animation(span, model.keys),
        )
    except GsgenError as error:
        nested_fields.close()
        separator = ": " if error.where.startswith(nested_fields.name) else "."
        where = (
            error.where if model.where in error.where else f"{model.where}{separator}{error.where}"
        )
        raise error.located(where) from error


def _open_mesh(part: SceneMesh) -> Source:
    meshes = locate_errors(lambda: read_mesh(part.path), f"{part.where}.path")
    return MeshSource(
        part.path,
        [
            replace(mesh.placed(part.transform), shading=part.shading or mesh.shading)
            for mesh in meshes
        ],
    )


def locate_errors(open_file: Callable[[], Result], where: str) -> Result:
    """Open a file that a scene file names, and add the location in the scene file to errors."""
    try:
        return open_file()
    except GsgenError as error:
        if error.where.startswith(where.removesuffix(".path")):
            raise
        error_where = f"{where}: {error.where}" if error.where else where
        raise error.located(error_where) from error


def _document(path: Path) -> Mapping[str, object]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise SceneUnreadable(
                f"is larger than {_MAX_BYTES:,} bytes, the limit of scene files", where=str(path)
            )
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneUnreadable(f"cannot be read: {error}", where=str(path)) from error
    try:
        document = json.loads(text, object_pairs_hook=_reject_duplicates)
    except (ValueError, RecursionError) as error:
        raise SceneUnreadable(f"is not valid JSON: {error}", where=str(path)) from error
    if not isinstance(document, dict):
        raise SceneInvalid(f"is a {type(document).__name__}, expected an object", where=str(path))
    return document


def _reject_duplicates(pairs: list[tuple[str, object]]) -> dict[str, object]:
    members = dict(pairs)
    if len(members) < len(pairs):
        names = [name for name, _ in pairs]
        duplicate = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"the name {duplicate!r} occurs twice in one JSON object")
    return members


def _read_model_entry(fields: Fields, folder: Path) -> SceneModel:
    opacity_scale = fields.number("opacity_scale", low=0)
    inputs, keys = fields.values_or_keys("inputs")
    segments, capacity = read_segments(fields, folder)
    model = SceneModel(
        path=None if segments else folder / fields.required_text("path"),
        segments=segments,
        capacity=capacity,
        transform=read_transform(fields),
        settings=DrawSettings(
            opacity_scale=1.0 if opacity_scale is None else opacity_scale,
            sh_degree=fields.integer("sh_degree", low=0, high=3),
            antialias=fields.choice("antialias", ("classic", "mip")),
            clip=_read_clip_box(fields),
            sorted=fields.choice("blend", ("alpha", "declared")) == "alpha",
        ),
        inputs=inputs,
        keys=keys,
        where=fields.where,
        visible=fields.switch("visible", default=True),
    )
    fields.close()
    return model


def _read_mesh(fields: Fields, folder: Path) -> SceneMesh:
    path = folder / fields.required_text("path")
    opacity = fields.number("opacity_scale", low=0, high=1)
    page_only = {
        "the FBX file": path.suffix.lower() == _FBX,
        "its animation": fields.name_or_number("animation") is not None,
        "its opacity": opacity not in (None, 1),
    }
    part = SceneMesh(
        path=path,
        transform=read_transform(fields),
        shading=fields.choice("shading", SHADINGS),
        where=fields.where,
        visible=fields.switch("visible", default=True),
        page_only=tuple(name for name, is_used in page_only.items() if is_used),
    )
    fields.close()
    return part


def _read_annotation(fields: Fields) -> SceneAnnotation:
    position = fields.array("position", (3,))
    if position is None:
        fields.refuse("position", "is missing, expected 3 numbers")
    camera = fields.text("camera")
    place = None if camera is None else _keyed_place(camera)
    if camera is not None and place is None:
        fields.refuse("camera", f"is {camera!r}, expected {_CAMERA_FORMS}")
    annotation = SceneAnnotation(
        position=position,
        text=fields.required_text("text"),
        normal=fields.array("normal", (3,)),
        camera=None if place is None else tuple(place),
    )
    fields.close()
    return annotation


def _read_post(fields: Fields, folder: Path) -> ScenePost:
    path = folder / fields.required_text("path")
    inputs, keys = fields.values_or_keys("inputs")
    fields.close()
    return ScenePost(path, inputs, keys, fields.where)


def _read_clip_box(fields: Fields) -> Box | None:
    if not fields.has_field("clip"):
        return None
    nested_fields = fields.nested_fields("clip")
    low, high = nested_fields.array("low", (3,)), nested_fields.array("high", (3,))
    nested_fields.close()
    if low is None or high is None or not (low <= high).all():
        fields.refuse("clip", 'expected {"low": [x, y, z], "high": [x, y, z]} with low <= high')
    return Box(tuple(low.tolist()), tuple(high.tolist()))


def _background(fields: Fields) -> tuple[float, float, float, float] | None:
    value = fields.text_or("background", list, "numbers")
    if value is None:
        return None
    text = ",".join(map(str, value)) if isinstance(value, list) else value
    return color_of(text, fields.location("background"))


def _read_fov(fields: Fields) -> float | None:
    degrees = fields.number("fov", low=0, high=180)
    if degrees in (0, 180):
        fields.refuse("fov", f"is {degrees:g} degrees, expected more than 0 and less than 180")
    return degrees


def _span(fields: Fields, last: float) -> Span | None:
    """Return the timeline, by default up to the last key frame."""
    if not fields.has_field("timeline"):
        return Span(last) if last > 0 else None
    nested_fields = fields.nested_fields("timeline")
    seconds = nested_fields.number("seconds", low=0)
    fps = nested_fields.number("fps", low=0.1, high=100)
    loop = nested_fields.switch("loop")
    nested_fields.close()
    length = last if seconds is None else seconds
    if not length > 0:
        nested_fields.refuse("seconds", "is 0, expected a number above 0, or key frames")
    return Span(length, fps or DEFAULT_FPS, loop)


def _keyed_place(value: object) -> list[float] | None:
    """Return the numbers of an orbit, or of an eye and a target; None of other values."""
    if value == "orbit":
        return [30.0, 20.0]
    form, _, text = value.partition(":") if isinstance(value, str) else ("", "", "")
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        return None
    is_place = len(numbers) in {"orbit": (2, 3), "look-at": (6,)}.get(form, ())
    return numbers if is_place and np.isfinite(numbers).all() else None


def _camera(fields: Fields, folder: Path) -> str | Camera | KeyFrames | None:
    value = fields.text_or("camera", dict, "an object")
    if isinstance(value, dict) and isinstance(value.get("keys"), list):
        return fields.nested_fields("camera").key_frames(_keyed_place, _CAMERA_FORMS)
    if isinstance(value, dict):
        try:
            return Camera.from_dict(value)
        except SceneInvalid as error:
            where = error.where.replace("camera", fields.location("camera"), 1)
            raise SceneInvalid(error.message, where=where, hint=error.hint) from error
    if value is None:
        return None
    is_description = value.partition(":")[0] in ("orbit", "look-at")
    return value if is_description else str(folder / value)
