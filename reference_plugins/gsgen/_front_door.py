"""What a program needs first, each in one line and in the words of the command of that name.

These are the names of :mod:`gsgen` itself. Models run in this process, without limits: your own,
not a stranger's, which ``gsgen render`` confines.
"""

__all__ = ["bake", "convert", "export", "load", "render", "validate", "view"]

import functools
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

from gsgen.contract.errors import ConfigInvalid, GsgenError, UnknownName, names_meant

if TYPE_CHECKING:
    import numpy as np
    from rendercanvas import BaseRenderCanvas

    from gsgen.contract.validation.report import Report
    from gsgen.formats import Splats
    from gsgen.formats.conversion import Conversion
    from gsgen.runtime import Camera, Frame, Scene, SplatData
    from gsgen.runtime.baking.report import BakeReport
    from gsgen.runtime.media.pictures import Mode
    from gsgen.sdk.exporting.pipeline import Exported

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")
_FilePath = str | os.PathLike[str]


def _files_as_os_errors(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
    """Let errors of a missing or unreadable file be OSErrors, too, as those of ``open`` are."""

    @functools.wraps(function)
    def call(*args: _Parameters.args, **options: _Parameters.kwargs) -> _Result:
        try:
            return function(*args, **options)
        except GsgenError as error:
            if isinstance(error, OSError):
                raise
            cause = error
            while cause is not None and not isinstance(cause, OSError):
                cause = cause.__cause__ or cause.__context__  # type: ignore[assignment]
            if cause is None:
                raise
            raise _os_error(error, type(cause)) from error

    return call


def _os_error(error: GsgenError, kind: type[OSError]) -> GsgenError:
    """Return an error as one of its own class and of a class of OSError."""
    both = type(type(error).__name__, (type(error), kind), {"__module__": type(error).__module__})
    located: GsgenError = both.__new__(both, *error.args)
    located.__dict__.update(error.__dict__)
    return located


@_files_as_os_errors
def load(path: _FilePath) -> "Splats":
    """Read the splats of a file; packed rows become splats of equal covariance and colour.

    Args:
        path: A splat file of any format, an address of one, the folder of a 3DGS training, of which
            the newest iteration is read, an archive, or a tileset, of which all leaves are.

    Raises:
        FormatError: The file is missing, damaged or of another kind; for a missing one, the error
            is a FileNotFoundError, too.
        NotSupported: The file holds points alone, which :func:`gsgen.formats.open_splats` reads.
    """
    from gsgen.formats import NotSupported, PackedRows, PointCloud, splats_of_rows
    from gsgen.tiles.loading.leaves import open_splats

    content = open_splats(path)
    if isinstance(content, PointCloud):
        raise NotSupported(
            "holds points without sizes",
            expected="splats",
            hint="gsgen.formats.open_splats reads points.",
            path=str(path),
        )
    return splats_of_rows(content) if isinstance(content, PackedRows) else content


@_files_as_os_errors
def validate(
    path: _FilePath,
    *,
    level: str | None = None,
    target: str | None = None,
    fail_on: str | None = None,
    ignore: Sequence[str] = (),
    only: Sequence[str] = (),
    severity: Sequence[str] = (),
    strict: bool = False,
    seed: int | None = None,
    timeout: float | None = None,
) -> "Report":
    """Check a model, a tileset or a scene file against the contract; ``print(report)`` prints it.

    Args:
        path: The ONNX file or its address, a tileset, or a scene file.
        level: How far to go: static, values, behaviour, live or render.
        target: The consumer to validate for, such as core or webgpu.
        fail_on: The lowest severity that fails: error, warning or info.
        ignore: Rules, by id or name, whose findings do not count.
        only: The only rules to check.
        severity: Entries RULE=SEVERITY, in place of the rules' own severities.
        strict: Whether a missing manifest is an error for every target.
        seed: Seed of the probe set.
        timeout: Time limit for all runs of the model, in seconds.

    Raises:
        ModelUnreadable: The file is not an ONNX model.
        ConfigInvalid: An option is invalid.
    """
    from gsgen.contract.validation.settings_from_options import make_settings
    from gsgen.formats.tileset_paths import names_tileset_or_content
    from gsgen.tiles.validation.rules import all_rules

    options: dict[str, Any] = {
        "level": level,
        "target": target,
        "fail_on": fail_on,
        "ignore": ignore,
        "only": only,
        "severity": severity,
        "strict": strict,
        "seed": seed,
        "timeout": timeout,
    }
    settings = make_settings(all_rules(), prefix="", **options)
    if names_tileset_or_content(Path(path)):
        from gsgen.tiles.validation.validate import validate as validate_tileset

        return validate_tileset(Path(path), settings)
    from gsgen.contract.validator import validate as validate_model

    return validate_model(path, settings)


@_files_as_os_errors
def render(
    scene: "Splats | SplatData | Scene | _FilePath | Sequence[_FilePath]",
    output: _FilePath | None = None,
    *,
    camera: str | None = None,
    size: tuple[int, int] | None = None,
    fov: float | None = None,
    up: str | None = None,
    mode: "Mode" = "color",
    background: str | None = None,
    time: float | None = None,
    frames: int | None = None,
    fps: float | None = None,
) -> "Frame":
    """Draw splats, meshes and generators, and return the last frame.

    Args:
        scene: Splats, a scene in memory, or files as ``gsgen render`` takes them.
        output: A picture, a video or a folder of frames to write; nothing is written without.
        camera: A value of ``gsgen render --camera``; by default, an orbit shows all of the scene.
        size: Width and height in pixels.
        fov: Vertical field of view, in degrees.
        up: The axis that points up, such as -y.
        mode: The output to show: color, depth, median-depth, normal or alpha.
        background: A colour, such as white; by default that of the scene file, or black.
        time: Time of generators.
        frames: The number of frames.
        fps: Frames a second of a video.

    Raises:
        SceneUnreadable: A file cannot be read.
        ConfigInvalid: An option is invalid.
        DeviceUnavailable: There is no graphics device.
    """
    from gsgen.formats import Splats
    from gsgen.runtime.playback.frame_sequence import FrameSequence
    from gsgen.runtime.playback.scene_camera import first_setting, scene_viewpoint
    from gsgen.runtime.scene.colors import color_of
    from gsgen.runtime.scene.splat_data import SplatData
    from gsgen.runtime.sources.scene_file import is_scene_file, read_scene
    from gsgen.runtime.sources.scene_source import sources_of

    if isinstance(scene, Splats):
        scene = SplatData.from_splats(scene)
    paths = [scene] if isinstance(scene, str | os.PathLike) else scene
    files = (
        [read_scene(Path(path)) for path in paths if is_scene_file(Path(path))]
        if isinstance(paths, Sequence)
        else []
    )
    width, height = size or (None, None)
    view = scene_viewpoint(files, camera, width, height, fov, up)
    color = first_setting(
        [
            None if background is None else color_of(background, "background"),
            *(file.background for file in files),
        ]
    )
    with ExitStack() as stack:
        sources = sources_of(_as_paths(scene), _tileset_opener())
        for source in sources:
            stack.callback(source.close)
        sequence = FrameSequence(
            sources,
            view,
            mode,
            background=color or (0.0, 0.0, 0.0, 1.0),
            time=time,
            frames=frames,
            fps=fps,
        )
        if output is None:
            return sequence.draw(sequence.frames - 1)
        sequence.write(Path(output))
        return sequence.last_frame


def _as_paths(scene: Any) -> Any:
    """Return the paths of a scene as :class:`Path` or a list of them; other scenes as they are."""
    if isinstance(scene, str | os.PathLike):
        return Path(scene)
    return [Path(path) for path in scene] if isinstance(scene, Sequence) else scene


def _tileset_opener() -> Any:
    from gsgen.tiles import open_stream

    return open_stream


@_files_as_os_errors
def convert(
    source: _FilePath | Sequence[_FilePath],
    target: _FilePath,
    *,
    format: str | None = None,
    sh_degree: int | None = None,
    drop_invalid: bool = False,
) -> "Conversion":
    """Write splats in another format; several sources are merged.

    Args:
        source: What :func:`load` reads, or a sequence of such.
        target: The file to write.
        format: The name of its format; by default, the suffix of ``target`` chooses it.
        sh_degree: Harmonics above this degree are dropped.
        drop_invalid: Whether to drop rows that cannot be drawn.

    Returns:
        The numbers of the conversion, and what the format rounds or drops.

    Raises:
        FormatError: The source cannot be read, or the format cannot store it.
        ConfigInvalid: No format has this suffix or name.
    """
    from gsgen.formats.conversion import convert as convert_file
    from gsgen.runtime.baking.targets import writable_codec

    codec = writable_codec(Path(target), format, where=str(target))
    return convert_file(source, target, codec, sh_degree=sh_degree, drop_invalid=drop_invalid)


@_files_as_os_errors
def export(
    source: object,
    output: _FilePath,
    *,
    method: str = "static",
    name: str | None = None,
    dtype: str | None = None,
    target: str = "core",
    level: str = "behaviour",
    **options: Any,
) -> "Exported":
    """Export a torch generator, or the files of a method, as an ONNX model.

    Args:
        source: A module of :class:`gsgen.sdk.GaussianGenerator`, or the path of the files.
        output: The model to write; it appears if it passed every check.
        method: The method of the files, as after ``gsgen export``; not used for a module.
        name: The name in the manifest; the file's by default.
        dtype: float32 or float16.
        target: The consumer to rewrite and validate for.
        level: The last level of the validation.
        **options: Options of the method, such as ``iteration=7000``.

    Raises:
        UnknownName: No plugin has this name.
        ExportFailed: The module cannot be exported; ExportRejected if the model does not conform.
    """
    from gsgen.contract.spec.severity import Level
    from gsgen.contract.validation.settings import Settings
    from gsgen.sdk.exporting.constant_generator import ConstantSource, export_constant

    if isinstance(source, str | os.PathLike):
        source = _built(method, Path(source), options)
    elif options:
        raise ConfigInvalid("is an option of methods alone", where=next(iter(options)))
    common: dict[str, Any] = {
        "name": name,
        "dtype": dtype,
        "target": target,
        "settings": Settings(level=Level.parse(level, "level")),
    }
    if isinstance(source, ConstantSource):
        return export_constant(source, output, **common)
    from gsgen.sdk.authoring.post_process import PostProcess
    from gsgen.sdk.exporting.exporter import export as export_module
    from gsgen.sdk.exporting.post_process_exporter import export_post_process

    if isinstance(source, PostProcess):
        return export_post_process(source, output, **common | {"dtype": dtype or "float32"})
    return export_module(cast("Any", source), output, **common)


def _built(method: str, source: Path, options: Mapping[str, Any]) -> Any:
    """Return the module or scene that a method's plugin builds from a path."""
    from gsgen.sdk.plugins.plugin import find_plugins, words_of_plugins

    extensions, words = find_plugins(), words_of_plugins()
    meant = [method] if method in extensions else names_meant(method, words)
    if len(meant) != 1:
        raise UnknownName.among("method", method, extensions, "method", words)
    plugin = extensions[meant[0]].load()
    if plugin.build is None:
        raise ConfigInvalid("is exported by its command alone", where=f"method {method!r}")
    return plugin.build(source, **options)


@_files_as_os_errors
def bake(
    model: _FilePath,
    output: _FilePath,
    *,
    time: "float | np.ndarray | None" = None,
    values: Mapping[str, object] | None = None,
    camera: "Camera | None" = None,
    format: str | None = None,
) -> "BakeReport":
    """Write frames of a generator as plain splat files, which every viewer reads.

    Args:
        model: The ONNX generator.
        output: The file to write; with ``%04d`` for the frame's number where there are several.
        time: One time, or one per frame.
        values: Tensor name or role → one value, or one per frame along a first axis.
        camera: Bake what this camera sees; by default, colours are fitted for all cameras.
        format: The name of the format; by default, the suffix of ``output`` chooses it.

    Raises:
        ModelUnreadable: The file is not an ONNX model.
        ConfigInvalid: An option or a value is invalid.
    """
    from gsgen.runtime.baking.bake_frames import bake as bake_frames

    return bake_frames(model, output, time=time, values=values, camera=camera, format=format)


@_files_as_os_errors
def view(
    scene: "Splats | SplatData | Scene | _FilePath | Sequence[_FilePath]",
    *,
    camera: str | None = None,
    size: tuple[int, int] = (960, 540),
) -> "BaseRenderCanvas":
    """Show a scene in a notebook, or in a window of your own event loop.

    In a script, run the loop: ``from rendercanvas.auto import loop; loop.run()``.

    Args:
        scene: What :func:`render` takes.
        camera: A value of ``gsgen view --camera``.
        size: Width and height of the canvas, in pixels.

    Raises:
        DisplayUnavailable: Neither a notebook widget nor a window can be created.
    """
    from gsgen.formats import Splats
    from gsgen.runtime.scene.splat_data import SplatData
    from gsgen.runtime.viewer.window import view as show

    if isinstance(scene, Splats):
        scene = SplatData.from_splats(scene)
    return show(_as_paths(scene), camera=camera, size=size, stream=_tileset_opener())
