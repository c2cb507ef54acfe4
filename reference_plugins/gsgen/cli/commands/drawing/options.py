"""Options that several commands share, with one name and help text each."""

__all__ = [
    "Antialias",
    "Axis",
    "Compact",
    "FieldOfView",
    "Height",
    "ImageSizes",
    "Inputs",
    "ModeOption",
    "ModelMemory",
    "ModelTimeout",
    "Origin",
    "OrtFolder",
    "Orthographic",
    "Panorama",
    "Poses",
    "Post",
    "PrintJsonOption",
    "Provider",
    "RasteriserName",
    "RenderCamera",
    "Scenes",
    "ShDegree",
    "Sizes",
    "ThreeFolder",
    "TrustOption",
    "Width",
    "mode_of",
    "model_limits",
    "read_tracks",
    "split_image_size",
    "time_option",
]

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from gsgen.contract.errors import ConfigInvalid

if TYPE_CHECKING:
    from gsgen.contract.process.limits import Limits
    from gsgen.runtime.media.pictures import Mode
    from gsgen.runtime.playback.input_tracks import Track
    from gsgen.runtime.sources.source import Source


Antialias = Annotated[
    Literal["classic", "mip"] | None,
    typer.Option(help="Antialiasing of the training. [default: the manifest's, or classic]"),
]
PrintJsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Axis = Annotated[
    Literal["+x", "-x", "+y", "-y", "+z", "-z"] | None,
    typer.Option(help="Axis that points up. [default: the manifest's, or -y]"),
]
Compact = Annotated[
    bool,
    typer.Option(
        "--compact",
        help="Keep Gaussians in about half the memory; colours change by less than a hundredth.",
    ),
]
FieldOfView = Annotated[
    float | None, typer.Option(help="Vertical field of view, in degrees. [default: 50]")
]
Height = Annotated[
    int | None, typer.Option(help="Height in pixels. [default: the camera's, or 720]", min=1)
]
ImageSizes = Annotated[
    list[str] | None,
    typer.Option(
        "--size",
        metavar="WIDTHxHEIGHT",
        help="Size of the image in pixels, such as 640x360; or SYMBOL=SIZE, the size of an open "
        "dimension of a model; repeatable.",
    ),
]
Images = Annotated[
    list[str] | None,
    typer.Option(
        "--image",
        metavar="FILE,FILE,…",
        help="Pictures that a generator computes its Gaussians from: files, a folder, or a pattern; "
        "they are cropped and resized to the model's size. Repeatable.",
    ),
]
ImageCameras = Annotated[
    str | None,
    typer.Option(
        "--image-cameras",
        metavar="FILE",
        help="Cameras of these pictures, in any format of --camera, by their names or in order; "
        "#NAME, #NUMBER or #0:4 after it picks some.",
    ),
]
Inputs = Annotated[
    list[str] | None,
    typer.Option(
        "--input",
        metavar="NAME=VALUE",
        help="Another input, by its name or role: a number, A,B,…, FROM..TO, or a file (sound: .wav); "
        "repeatable.",
    ),
]
ModeOption = Annotated[
    Literal["color", "colour", "depth", "median-depth", "normal", "alpha"],
    typer.Option("--mode", help="Output to show.", case_sensitive=False),
]
ModelMemory = Annotated[
    int | None,
    typer.Option(
        "--memory",
        help="Memory limit of the process that runs models, in MiB; the weights come on top.",
        show_default="2048",
        min=64,
    ),
]
ModelTimeout = Annotated[
    float | None,
    typer.Option(
        "--timeout",
        help="Time limit for loading a model and for each of its frames, in seconds.",
        show_default="60",
        min=0.1,
    ),
]
Orthographic = Annotated[
    bool,
    typer.Option(
        "--orthographic", help="Draw without perspective; the centre of the scene keeps its size."
    ),
]
Panorama = Annotated[
    bool,
    typer.Option(
        "--panorama",
        help="Draw all directions, equirectangular: from the middle, or from the camera.",
    ),
]
Origin = Annotated[
    str,
    typer.Option(
        metavar="auto|X,Y,Z",
        help="Point of the files that float32 positions are relative to; auto: 0,0,0, or a point "
        "that map coordinates need. Cameras, edits and boxes keep the coordinates of the files.",
    ),
]
OrtFolder = Annotated[
    Path | None,
    typer.Option(
        "--ort",
        help="Folder of ONNX Runtime Web, which computes generators in a page. "
        "[default: fetched once by npm]",
        metavar="DIR",
    ),
]
ThreeFolder = Annotated[
    Path | None,
    typer.Option(
        "--three",
        help="Folder of three.js, which draws meshes in a page, and models where a browser has no "
        "WebGPU. [default: fetched once by npm, for meshes]",
        metavar="DIR",
    ),
]
Poses = Annotated[
    list[str] | None,
    typer.Option(
        "--pose",
        metavar="[NAME=]FILE",
        help="Poses, frame by frame: .npy, .npz or .json of [J,3] or [F,J,3], an .npz of AMASS, "
        "LHM's .json, or a folder of such files; repeatable.",
    ),
]
Post = Annotated[
    list[Path] | None,
    typer.Option(
        help="Post-process model that the picture goes through; repeatable, in this order."
    ),
]
Provider = Annotated[
    Literal["auto", "cpu", "webgpu", "cuda"],
    typer.Option(help="Execution provider of ONNX Runtime."),
]
RasteriserName = Annotated[
    Literal["auto", "tiles", "quads"],
    typer.Option(
        help="Rasteriser: compute shaders (tiles), the hardware (quads), or the faster one."
    ),
]
RenderCamera = Annotated[
    str | None,
    typer.Option(
        "--camera",
        help="orbit[:AZ,EL[,RADIUS]] (azimuth and elevation in degrees), "
        "look-at:EX,EY,EZ,TX,TY,TZ (eye and target), or a file or folder of cameras; #NAME or "
        "#NUMBER after it picks one. "
        "[default: an orbit around the first model, with all of it but floaters in view]",
    ),
]
Scenes = Annotated[
    list[Path],
    typer.Argument(
        help="Splat files, meshes, ONNX generators, tilesets and scene.json, or their addresses "
        "(https, hf, s3, …); "
        "several form one scene. A folder of numbered splat files, or a pattern such as "
        "frames/%04d.ply, is a sequence in time.",
        show_default=False,
    ),
]
ShDegree = Annotated[
    int | None, typer.Option(help="Highest degree of spherical harmonics to use.", min=0, max=3)
]
Sizes = Annotated[
    list[str] | None,
    typer.Option(metavar="SYMBOL=SIZE", help="Size of an open dimension of a model; repeatable."),
]
TrustOption = Annotated[
    bool,
    typer.Option(
        "--trust", help="Run models in this process, without limits: your own, not a stranger's."
    ),
]
Width = Annotated[
    int | None, typer.Option(help="Width in pixels. [default: the camera's, or 1280]", min=1)
]


_MODEL_OR_SCENE_SUFFIXES = (".onnx", ".json")  # of models, and scene files that may name one
_IMAGE_SIZE = re.compile(r"([1-9]\d*)\s*[x×*,]\s*([1-9]\d*)", re.ASCII | re.IGNORECASE)


def split_image_size(
    entries: list[str] | None, width: int | None, height: int | None, paths: Sequence[Path] = ()
) -> tuple[list[str], int | None, int | None]:
    """Separate ``--size`` values into sizes of model dimensions and the size of the image.

    Args:
        entries: The values of ``--size``.
        width: The value of ``--width``.
        height: The value of ``--height``.
        paths: The scenes; for splats and meshes, error messages expect a size in pixels alone.

    Returns:
        The values SYMBOL=SIZE; width and height in pixels, those of ``--width`` and ``--height``
        where ``--size`` names none.

    Raises:
        ConfigInvalid: A value is of neither form, or the size of the image is given twice.
    """
    symbols: list[str] = []
    for entry in entries or ():
        match = _IMAGE_SIZE.fullmatch(entry.strip())
        if match is None and "=" not in entry:
            raise _invalid_size(entry, paths)
        if match is None:
            symbols.append(entry)
            continue
        if width is not None or height is not None:
            raise ConfigInvalid(
                "the size of the image is given twice",
                where=f"--size {entry}",
                hint="Give --size 640x360 once, without --width and --height.",
            )
        width, height = int(match[1]), int(match[2])
    return symbols, width, height


def _invalid_size(entry: str, paths: Sequence[Path]) -> ConfigInvalid:
    picture = "WIDTHxHEIGHT, such as 640x360"
    message = f"{entry!r} is not a size of a picture, expected {picture}"
    if any(path.suffix.lower() in _MODEL_OR_SCENE_SUFFIXES for path in paths):
        message = f"the value is {entry!r}, expected SYMBOL=SIZE, such as J=24, or {picture}"
    return ConfigInvalid(message, where="--size")


def time_option(help: str) -> Any:
    """Return the option ``--time``, whose value is one number."""
    return typer.Option(help=help, parser=_time_value, metavar="FLOAT")


def _time_value(text: str) -> float:
    """Parse the value of ``--time``, one number.

    Raises:
        ConfigInvalid: The text is a range, or not a number.
    """
    try:
        return float(text)
    except ValueError as error:
        first, *other_times = re.split(r":|\.\.", text)
        if not other_times:
            message = f"{text!r} is not a number, expected a time, such as 0.5"
            raise ConfigInvalid(message, where="--time") from error
        count = other_times[1] if len(other_times) > 1 and other_times[1].isdecimal() else "100"
        raise ConfigInvalid(
            f"{text!r} is a range, expected one time, such as 0.5",
            where="--time",
            hint="Without --time, --frames N goes through the whole range of the model; a part of "
            f"it is --input time={first}..{other_times[0]} --frames {count}.",
        ) from error


def model_limits(timeout: float | None, memory: int | None, *, trust: bool) -> "Limits | None":
    """Return the limits of a confined process for models; None for models that are trusted."""
    from gsgen.contract.process.limits import FRAME_SECONDS, Limits

    if trust:
        return None
    limits = Limits(seconds=FRAME_SECONDS if timeout is None else timeout)
    return limits if memory is None else replace(limits, memory=memory << 20)


def mode_of(name: str) -> "Mode":
    """Return the display mode of a value of ``--mode``, which allows both spellings of colour."""
    return "color" if name == "colour" else cast("Mode", name)


def read_tracks(
    poses: list[str] | None,
    inputs: list[str] | None,
    sources: "Sequence[Source]",
    fps: float | None = None,
    *,
    images: list[str] | None = None,
    image_cameras: str | None = None,
) -> "tuple[list[Track], float | None]":
    """Read the values of model inputs in each frame: of ``--pose``, ``--input`` and ``--image``.

    Args:
        poses: Values of ``--pose``.
        inputs: Values of ``--input``.
        sources: The scenes, whose inputs are named.
        fps: Frames per second that the user asked for, which sound is read for.
        images: Values of ``--image``.
        image_cameras: Value of ``--image-cameras``.

    Returns:
        A track for each input, and the frames per second of the first file of poses that has them.

    Raises:
        ConfigInvalid: A text or a file is invalid, or no source has an input of this name.
    """
    tracks: list[Track] = []
    pose_fps: float | None = None
    if poses:
        from gsgen.runtime.playback.pose_tracks import named_file, pose_tracks

        for text in poses:
            name = named_file(text)[0]
            source = _source_with_input(name, sources, f"--pose {text}")
            file_tracks, file_fps = pose_tracks(text, source)
            tracks, pose_fps = [*tracks, *file_tracks], pose_fps or file_fps
    if inputs:
        tracks += _input_tracks(inputs, sources, fps or pose_fps)
    if images or image_cameras is not None:
        from gsgen.runtime.playback.picture_inputs import picture_tracks

        tracks += picture_tracks(images or (), image_cameras, sources)
    return tracks, pose_fps


def _input_tracks(
    inputs: Iterable[str], sources: "Sequence[Source]", fps: float | None
) -> "Iterator[Track]":
    """Read the values of ``--input``; sound for a rate of frames, by default that of the scenes."""
    from gsgen.runtime.playback.input_tracks import input_track
    from gsgen.runtime.playback.playback import frame_rate
    from gsgen.runtime.playback.sound_tracks import SOUND_SUFFIX, sound_track

    for text in inputs:
        name, _, value = text.partition("=")
        if Path(value).suffix.lower() == SOUND_SUFFIX:
            source = _source_with_input(name, sources, f"--input {text}")
            spec = source.named(name)[0]
            shape = source.shape(spec.name)
            yield sound_track(Path(value), spec, shape, fps or frame_rate(sources))
        else:
            yield input_track(text)


def _source_with_input(name: str, sources: "Sequence[Source]", where: str) -> "Source":
    """Return the first of a scene's files and models that has an input of this name or role."""
    for source in sources:
        if source.named(name):
            return source
    raise ConfigInvalid(
        f"names the input {name!r}, which no scene has",
        where=where,
        hint="`gsgen inspect` lists the inputs of a model.",
    )
