"""Scene files: models and meshes, each with its place, in one ``scene.json``."""

__all__ = ["SceneFile", "is_scene_file", "open_scene", "read_scene"]

import json
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal, TypeVar, final

import numpy as np
from jaxtyping import Float

from gsgen.contract.errors import GsgenError
from gsgen.runtime.errors import SceneInvalid, SceneUnreadable
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.colors import color_of
from gsgen.runtime.scene.mesh import SHADINGS, Shading
from gsgen.runtime.scene.scene import Box
from gsgen.runtime.scene.transforms import require_affine
from gsgen.runtime.sources.mesh_files import read_mesh
from gsgen.runtime.sources.mesh_source import MeshSource
from gsgen.runtime.sources.placed_source import Look, PlacedSource
from gsgen.runtime.sources.scene_fields import Fields, fields_of, refuse
from gsgen.runtime.sources.source import Source, open_source

VERSION: Final = "1.0"
Read = TypeVar("Read")

_MARK: Final = "gsgen_scene"
_MARKS: Final = frozenset({_MARK, "models", "meshes"})
_LARGEST: Final = 64 << 20  # bytes: poses may be written out in it


@final
@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A splat file or a generator of a scene file.

    Attributes:
        path: The file.
        transform: Local → world, [4, 4].
        look: How its Gaussians are drawn.
        inputs: Tensor name or role → value, for generators.
        where: Its place in the scene file.
    """

    path: Path
    transform: Float[np.ndarray, "4 4"]
    look: Look
    inputs: Mapping[str, Any]
    where: str


@final
@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """A mesh of a scene file.

    Attributes:
        path: The file.
        transform: Local → world, [4, 4].
        shading: How it is drawn; None for what the file suggests.
        where: Its place in the scene file.
    """

    path: Path
    transform: Float[np.ndarray, "4 4"]
    shading: Shading | None
    where: str


@final
@dataclass(frozen=True, slots=True, eq=False)
class SceneFile:
    """What a scene file says; what it does not say is None.

    Attributes:
        path: The file.
        models: In their order.
        meshes: In their order.
        background: Red, green, blue and alpha behind it all.
        camera: As ``--camera`` takes it, or a camera.
        width: Of the image, in pixels.
        height: Of the image, in pixels.
        fov: Vertical field of view, in degrees.
        up: Which axis of the world points up, whatever models say of their own.
        kind: ``pinhole``, ``orthographic`` or ``panorama``, where ``camera`` is no camera itself.
    """

    path: Path
    models: tuple[Model, ...]
    meshes: tuple[MeshPart, ...]
    background: tuple[float, float, float, float] | None = None
    camera: str | Camera | None = None
    width: int | None = None
    height: int | None = None
    fov: float | None = None
    up: str = "-y"
    kind: Literal["pinhole", "orthographic", "panorama"] | None = None


def is_scene_file(path: Path) -> bool:
    """Say whether a file is JSON that calls itself a scene, or has models or meshes."""
    if path.suffix.lower() != ".json" or not path.is_file():
        return False
    text = path.read_bytes()[:_LARGEST]
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):  # it is told then what is wrong with it
        return path.name == "scene.json" or any(
            f'"{name}"'.encode() in text for name in _MARKS
        )
    is_scene = isinstance(document, dict) and bool(_MARKS & document.keys())
    return is_scene or path.name == "scene.json"


def read_scene(path: str | Path) -> SceneFile:
    """Read and check a scene file; what it names is not opened.

    Raises:
        SceneUnreadable: It is no JSON.
        SceneInvalid: A field is unknown, missing, or cannot be meant; the message names it.
    """
    file = Path(path)
    fields = fields_of(_document(file), str(file))
    version = fields.take(_MARK, "text")
    if version is not None and version.split(".")[0] != VERSION.split(".")[0]:
        fields.refuse(_MARK, f"is {version!r}, wanted {VERSION}")
    models = tuple(_model(part, file.parent) for part in fields.parts("models"))
    meshes = tuple(_mesh(part, file.parent) for part in fields.parts("meshes"))
    if not models and not meshes:
        refuse("has neither models nor meshes", str(file), "Name a file in `models`.")
    scene_file = SceneFile(
        file,
        models,
        meshes,
        background=_background(fields),
        camera=_camera(fields, file.parent),
        width=fields.side("width"),
        height=fields.side("height"),
        fov=_fov(fields),
        up=fields.choice("up", ("+x", "-x", "+y", "-y", "+z", "-z")) or "-y",
        kind=fields.choice("kind", ("pinhole", "orthographic", "panorama")),
    )
    fields.close()
    return scene_file


def open_scene(
    scene: SceneFile | str | Path,
    provider: str = "cpu",
    sizes: Mapping[Path, Mapping[str, int]] | None = None,
) -> list[Source]:
    """Open what a scene file names: a source for each model, then one for each mesh.

    Give them to a ``Player`` or a ``FrameSequence``; close them in the end.

    Args:
        scene: The file, or what it says.
        provider: What ONNX Runtime runs generators on.
        sizes: For the file of a generator, symbol → size of a dimension that it leaves open.

    Raises:
        SceneUnreadable: A file cannot be read.
        GsgenError: Whatever a model raises; the message names its place in the file.
    """
    scene_file = scene if isinstance(scene, SceneFile) else read_scene(scene)
    with ExitStack() as stack:
        sources: list[Source] = []
        for model in scene_file.models:
            sources.append(_opened(model, provider, (sizes or {}).get(model.path)))
            stack.callback(sources[-1].close)
        sources += [_stood(mesh) for mesh in scene_file.meshes]
        stack.pop_all()  # whoever has the sources closes them
    return sources


def _opened(model: Model, provider: str, sizes: Mapping[str, int] | None) -> Source:
    if is_scene_file(model.path):
        refuse("is a scene file: scenes hold models, not scenes", f"{model.where}.path")
    inner = _named(lambda: open_source(model.path, provider, sizes), f"{model.where}.path")
    try:
        return PlacedSource(
            inner, model.transform, model.look, model.inputs, f"{model.where}.inputs"
        )
    except GsgenError as error:
        inner.close()
        joint = ": " if error.where.startswith(inner.name) else "."
        where = (
            error.where
            if model.where in error.where
            else f"{model.where}{joint}{error.where}"
        )
        raise type(error)(error.message, where=where, hint=error.hint) from error


def _stood(part: MeshPart) -> Source:
    meshes = _named(lambda: read_mesh(part.path), f"{part.where}.path")
    return MeshSource(
        part.path,
        [
            replace(mesh.placed(part.transform), shading=part.shading or mesh.shading)
            for mesh in meshes
        ],
    )


def _named(make: Callable[[], Read], where: str) -> Read:
    """Return what ``make`` makes; an error names the place in the scene file, too."""
    try:
        return make()
    except GsgenError as error:
        error_where = f"{where}: {error.where}" if error.where else where
        raise type(error)(error.message, where=error_where, hint=error.hint) from error


def _document(path: Path) -> Mapping[str, Any]:
    try:
        if path.stat().st_size > _LARGEST:
            raise SceneUnreadable(f"has more than {_LARGEST:,} bytes", where=str(path))
        text = path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneUnreadable(f"cannot be read: {error}", where=str(path)) from error
    try:
        document = json.loads(text, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise SceneUnreadable(f"is no JSON: {error}", where=str(path)) from error
    if not isinstance(document, dict):
        raise SceneInvalid(
            f"is a {type(document).__name__}, wanted an object", where=str(path)
        )
    return document


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    members = dict(pairs)
    if len(members) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{twice!r} is there twice in one object")
    return members


def _model(fields: Fields, folder: Path) -> Model:
    model = Model(
        folder / fields.required("path"),
        _transform(fields),
        Look(
            opacity_scale=fields.number("opacity_scale", low=0, fallback=1.0),
            sh_degree=fields.whole("sh_degree", low=0, high=3),
            antialias=fields.choice("antialias", ("classic", "mip")),
            clip=_clip(fields),
            sorted=fields.choice("blend", ("alpha", "declared")) == "alpha",
        ),
        fields.mapping("inputs"),
        fields.where,
    )
    fields.close()
    return model


def _mesh(fields: Fields, folder: Path) -> MeshPart:
    path = folder / fields.required("path")
    shading = fields.choice("shading", SHADINGS)
    part = MeshPart(path, _transform(fields), shading, fields.where)
    fields.close()
    return part


def _transform(fields: Fields) -> Float[np.ndarray, "4 4"]:
    """Return ``transform``, or else translate × rotate × scale."""
    matrix = fields.array("transform", (4, 4))
    steps = [name for name in ("translate", "rotate", "scale") if fields.has(name)]
    if matrix is not None:
        if steps:
            fields.refuse(steps[0], "and transform say the same: give one of them")
        _require(fields, "transform", matrix)
        return matrix
    transform = np.eye(4)
    scale = fields.array("scale", (), (3,))
    transform[:3, :3] = _rotation(fields) @ np.diag(
        np.broadcast_to(1.0 if scale is None else scale, 3)
    )
    translation = fields.array("translate", (3,))
    transform[:3, 3] = 0 if translation is None else translation
    _require(fields, "scale", transform)
    return transform


def _require(fields: Fields, name: str, matrix: Float[np.ndarray, "4 4"]) -> None:
    require_affine(matrix, fields.place(name))


def _rotation(fields: Fields) -> Float[np.ndarray, "3 3"]:
    """Return ``rotate``: a quaternion w, x, y, z, or an axis and degrees about it."""
    if isinstance(fields.peek("rotate"), Mapping):
        inner = fields.inner("rotate")
        axis = inner.array("axis", (3,))
        degrees = inner.number("degrees")
        inner.close()
        if axis is None or degrees is None or not np.linalg.norm(axis) > 0:
            fields.refuse(
                "rotate", 'wanted {"axis": [x, y, z], "degrees": d} or [w, x, y, z]'
            )
        half = np.radians(degrees) / 2
        turn = np.append(np.cos(half), np.sin(half) * axis / np.linalg.norm(axis))
    else:
        quaternion = fields.array("rotate", (4,))
        turn = np.array([1.0, 0, 0, 0]) if quaternion is None else quaternion
    length = np.linalg.norm(turn)
    if not length > 0:
        fields.refuse("rotate", "is the quaternion 0 0 0 0, which is no rotation")
    w, x, y, z = turn / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross)


def _clip(fields: Fields) -> Box | None:
    if not fields.has("clip"):
        return None
    inner = fields.inner("clip")
    low, high = inner.array("low", (3,)), inner.array("high", (3,))
    inner.close()
    if low is None or high is None or not (low <= high).all():
        fields.refuse("clip", 'wanted {"low": [x, y, z], "high": [x, y, z]}, low first')
    return Box(tuple(low.tolist()), tuple(high.tolist()))


def _background(fields: Fields) -> tuple[float, float, float, float] | None:
    value = fields.take("background", "text or numbers")
    if value is None:
        return None
    text = ",".join(map(str, value)) if isinstance(value, list) else str(value)
    return color_of(text, fields.place("background"))


def _fov(fields: Fields) -> float | None:
    degrees = fields.number("fov", low=0, high=180)
    if degrees in (0, 180):
        fields.refuse(
            "fov", f"is {degrees:g} degrees, wanted more than 0 and less than 180"
        )
    return degrees


def _camera(fields: Fields, folder: Path) -> str | Camera | None:
    value = fields.take("camera", "text or an object")
    if isinstance(value, Mapping):
        try:
            return Camera.from_dict(value)
        except SceneInvalid as error:
            where = error.where.replace("camera", fields.place("camera"), 1)
            raise SceneInvalid(error.message, where=where, hint=error.hint) from error
    if value is None:
        return None
    text = str(value)
    return text if text.partition(":")[0] in ("orbit", "look-at") else str(folder / text)
