"""Opens the scenes and post-process models of a command, and prints their warnings."""

__all__ = [
    "confined_models",
    "open_scenes",
    "read_scene_files",
    "read_splats",
    "tileset_opener",
    "training_camera",
]

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from gsgen.cli.output import echo, echo_error
from gsgen.contract.errors import ConfigInvalid, ExitCode, InputUnreadable, UnknownName
from gsgen.contract.process.atomic_files import MODEL_SUFFIX
from gsgen.formats import PackedRows, PointCloud, Splats, open_splats
from gsgen.formats.tileset_paths import names_stream, names_tileset

if TYPE_CHECKING:
    from gsgen.contract.process.limits import Limits
    from gsgen.formats.shared.origins import Origin
    from gsgen.runtime.playback.post_process import PostProcessor
    from gsgen.runtime.sources.scene_file import SceneFile
    from gsgen.runtime.sources.source import Source
    from gsgen.runtime.sources.stream_settings import StreamOpener, StreamSettings
    from gsgen.sdk.binding.confined.models import ConfinedModels


def read_scene_files(scenes: Sequence[Path]) -> "dict[Path, SceneFile]":
    """Read the scene files among the paths of a command's scenes.

    Raises:
        typer.Exit: A file cannot be read; the reason is printed.
        GsgenError: A file is invalid.
    """
    from gsgen.runtime.errors import SceneUnreadable
    from gsgen.runtime.sources.scene_file import is_scene_file, read_scene

    try:
        return {path: read_scene(path) for path in scenes if is_scene_file(path)}
    except SceneUnreadable as error:
        echo_error(error)
        raise typer.Exit(ExitCode.UNREADABLE) from error


@contextmanager
def open_scenes(
    scenes: Sequence[Path],
    post: Sequence[Path] | None = None,
    *,
    provider: str = "cpu",
    size: Sequence[str] | None = None,
    streaming: "StreamSettings | None" = None,
    limits: "Limits | None" = None,
    origin: "Origin | None" = None,
    scene_posts: bool = True,
) -> "Iterator[tuple[list[Source], list[PostProcessor]]]":
    """Open scenes and post-process models, print their warnings as notes, and close them.

    Args:
        scenes: Splat files, meshes, generators, and scene files.
        post: Post-process models, after those of scene files.
        provider: Execution provider of ONNX Runtime.
        streaming: How tilesets are streamed.
        size: Values of ``--size``; each model gets the sizes of its own open dimensions.
        limits: Limits of the process that runs models; None runs them in this process.
        origin: The point of splat files that positions are relative to; None for one that float32
            needs.
        scene_posts: Whether to open the post-process models of scene files.

    Raises:
        typer.Exit: A file cannot be read; the reason is printed.
        GsgenError: A model is of another kind, or does not run.
    """
    from gsgen.cli.model_options import sizes_of
    from gsgen.cli.progress import clear, progress
    from gsgen.runtime.errors import SceneUnreadable
    from gsgen.runtime.playback.post_process import PostProcessor, open_posts
    from gsgen.runtime.sources.opening import open_source
    from gsgen.runtime.sources.scene_file import open_scene
    from gsgen.runtime.sources.world_origins import align_world_origins

    sizes = sizes_of(size)
    files = read_scene_files(scenes)
    if not scene_posts:
        files = {path: replace(file, posts=()) for path, file in files.items()}
    model_paths = [path for file in files.values() for model in file.models for path in model.paths]
    model_paths += [model.path for file in files.values() for model in file.posts]
    with ExitStack() as exit_stack:
        confined = confined_models([*scenes, *model_paths], post or (), limits, provider)
        if confined is not None:
            exit_stack.callback(confined.close)
        stream = tileset_opener(_shared_budget(streaming, [*scenes, *model_paths]), confined)
        with _warnings_as_notes():
            try:
                sizes_by_path = _sizes_by_path([*scenes, *model_paths, *(post or ())], sizes or {})
                sources: list[Source] = []
                models: list[PostProcessor] = []
                for path in scenes:
                    progress(f"reading {path}")
                    opened_sources = (
                        open_scene(files[path], provider, sizes_by_path, stream, confined, origin)
                        if path in files
                        else [
                            open_source(
                                path, provider, sizes_by_path.get(path), stream, confined, origin
                            )
                        ]
                    )
                    sources += opened_sources
                    for source in opened_sources:
                        exit_stack.callback(source.close)
                for file in files.values():
                    for model in open_posts(file, provider, sizes_by_path, confined):
                        models.append(model)
                        exit_stack.callback(model.close)
                for path in post or ():
                    models.append(PostProcessor(path, provider, sizes_by_path.get(path), confined))
                    exit_stack.callback(models[-1].close)
            except (InputUnreadable, SceneUnreadable) as error:
                echo_error(error)
                raise typer.Exit(ExitCode.UNREADABLE) from error
            finally:
                clear()
        yield align_world_origins(sources), models


def confined_models(
    scenes: Sequence[Path], models: Sequence[Path], limits: "Limits | None", provider: str = "cpu"
) -> "ConfinedModels | None":
    """Return the confined processes for the models of a command; None if it needs none.

    The process of the models that are named starts at once.

    Args:
        scenes: Files of scenes, of any kind.
        models: Model files, with any suffix.
        limits: Limits of the processes; None runs models in this process.
        provider: Execution provider of ONNX Runtime.
    """
    models = [*(path for path in scenes if path.suffix.lower() == MODEL_SUFFIX), *models]
    if limits is None or not (models or any(map(names_tileset, scenes))):
        return None
    from gsgen.sdk.binding.confined.models import CAN_CONFINE, ConfinedModels

    if not CAN_CONFINE:
        echo("note: this system cannot confine models: they run without limits", err=True)
        return None
    return ConfinedModels(models, limits, has_gpu=provider != "cpu")


def training_camera(scenes: Sequence[Path]) -> str | None:
    """Return the first camera of the first scene that is the folder of a 3DGS training.

    The value is one of ``--camera``; a note names the camera. None without such a folder.
    """
    from gsgen.formats.inputs import training_folder

    for scene in scenes:
        run = training_folder(scene)
        if run is None or run.cameras is None:
            continue
        from gsgen.runtime.camera_files import open_cameras

        try:
            cameras = open_cameras(run.cameras).cameras
        except ConfigInvalid as error:
            echo(*f"note: not used: {error}".split("\n"), err=True)
            continue
        choice = f"{run.cameras}#{cameras[0].name}"
        text = f"camera {choice}, the first of {len(cameras)}: `--camera {run.cameras}` draws all"
        echo(f"note: {text}", err=True)
        return choice
    return None


def tileset_opener(
    settings: "StreamSettings | None" = None, confined: "ConfinedModels | None" = None
) -> "StreamOpener":
    """Return a function that opens a tileset as a source; gsgen.tiles is imported when it does."""

    def open_tileset(path: Path, provider: str) -> "Source":
        from gsgen.tiles.streaming.tiles_source import open_stream

        return open_stream(path, provider, settings, confined)

    return open_tileset


def _shared_budget(
    settings: "StreamSettings | None", paths: "Sequence[Path]"
) -> "StreamSettings | None":
    """Return the settings of each tileset of a command: an equal share of the Gaussians."""
    count = sum(map(names_stream, paths))
    if settings is None or count < 2:
        return settings
    return replace(settings, max_splats=settings.max_splats // count)


def read_splats(
    path: Path, *, drop_invalid: bool = False, origin: "Origin | None" = None
) -> Splats | PointCloud | PackedRows:
    """Read a splat file, or all leaves of a tileset, for which gsgen.tiles is imported."""
    if names_tileset(path):
        from gsgen.tiles.loading.leaves import open_splats as open_tileset

        return open_tileset(path, drop_invalid=drop_invalid, origin=origin)
    return open_splats(path, drop_invalid=drop_invalid, origin=origin)


@contextmanager
def _warnings_as_notes() -> Iterator[None]:
    """Print warnings of a ``with`` block to standard error, as notes."""
    with warnings.catch_warnings(record=True) as caught_warnings:
        warnings.simplefilter("always", UserWarning)
        yield
    for warning in caught_warnings:
        echo(f"note: {warning.message}", err=True)


def _sizes_by_path(paths: Sequence[Path], sizes: Mapping[str, int]) -> dict[Path, dict[str, int]]:
    """Return the sizes that the user set for each model's symbolic dimensions, by model path.

    Raises:
        UnknownName: No model has such an open dimension.
    """
    if not sizes:
        return {}
    from gsgen.sdk.binding.bound.model_facts import read_model_facts

    models = [path for path in paths if path.suffix.lower() == ".onnx"]
    open_sources = {
        path: {name for name, _ in read_model_facts(path, None).open_dimensions()}
        for path in models
    }
    known_symbols = set().union(*open_sources.values())
    for name in sizes:
        if name not in known_symbols:
            raise UnknownName.among("open dimension", name, known_symbols, "--size")
    return {
        path: {name: size for name, size in sizes.items() if name in names}
        for path, names in open_sources.items()
    }
