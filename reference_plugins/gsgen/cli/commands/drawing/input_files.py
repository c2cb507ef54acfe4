"""Lists the files that a drawing command reads, which its output must not overwrite."""

__all__ = ["input_files", "refuse_inputs", "scene_inputs"]

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

from gsgen.contract.process.atomic_files import refuse_itself

if TYPE_CHECKING:
    from gsgen.runtime.sources.scene_file import SceneFile

_MOTION_SUFFIXES: Final = (".npy", ".npz", ".json")
_REFERENCING_SUFFIXES: Final = (".gltf", ".json")  # files of text that name pictures beside them


def input_files(
    scenes: Iterable[Path],
    *,
    camera: str | None = None,
    poses: Iterable[str] | None = None,
    inputs: Iterable[str] | None = None,
    post: Iterable[Path] | None = None,
    images: Iterable[str] | None = None,
    image_cameras: str | None = None,
) -> list[Path]:
    """Return the paths that the options of a drawing command name; some may not exist.

    Args:
        scenes: Splat files, meshes, generators, and scene files.
        camera: The value of ``--camera``.
        poses: Values of ``--pose``; of a folder, its motion files.
        inputs: Values of ``--input``.
        post: Post-process models.
        images: Values of ``--image``.
        image_cameras: The value of ``--image-cameras``.
    """
    paths = [*scenes, *(post or ()), *_camera_files(camera), *_camera_files(image_cameras)]
    if images:
        from gsgen.runtime.playback.picture_inputs import picture_files

        paths += picture_files(images)
    if poses:
        from gsgen.runtime.playback.pose_tracks import named_file

        for text in poses:
            paths += _motion_files(named_file(text)[1])
    paths += [Path(text.partition("=")[2]) for text in inputs or ()]
    return paths


def scene_inputs(files: "Iterable[SceneFile]") -> list[Path]:
    """Return the paths that scene files name: models, meshes, post-process models and cameras."""
    paths: list[Path] = []
    for file in files:
        paths += [path for model in file.models for path in model.paths]
        paths += [mesh.path for mesh in file.meshes]
        paths += [post.path for post in file.posts]
        paths += _camera_files(file.camera if isinstance(file.camera, str) else None)
    return paths


def refuse_inputs(output: Path, paths: Sequence[Path]) -> None:
    """Raise if a picture, a video or a folder of frames would overwrite an input file.

    Pictures that a mesh or a SOG file among ``paths`` names are inputs, too.
    """
    targets = sorted(output.glob("frame_*.png")) if output.is_dir() else [output]
    pictures = {target for target in targets if target.is_file()}
    naming = list(_naming_texts(paths)) if pictures else []
    for target in targets:
        is_named_picture = target in pictures and any(
            target.resolve().is_relative_to(folder) and target.name.encode() in text
            for folder, text in naming
        )
        refuse_itself(target, [*paths, target] if is_named_picture else paths)


def _camera_files(camera: str | None) -> list[Path]:
    if camera is None:
        return []
    from gsgen.runtime.camera_files import split_pick

    return [split_pick(camera)[0]]


def _motion_files(path: Path) -> Iterator[Path]:
    if not path.is_dir():
        yield path
        return
    yield from (file for file in path.iterdir() if file.suffix.lower() in _MOTION_SUFFIXES)


def _naming_texts(paths: Iterable[Path]) -> Iterator[tuple[Path, bytes]]:
    """Yield the folder and the text of each file that may name pictures: SOG, glTF and materials."""
    for path in paths:
        texts = [path] if path.suffix.lower() in _REFERENCING_SUFFIXES and path.is_file() else []
        if path.suffix.lower() == ".obj":
            texts = list(path.parent.glob("*.mtl"))
        for text in texts:
            yield path.parent.resolve(), text.read_bytes()
