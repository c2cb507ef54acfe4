"""Checks the arguments of a frame: its scene, background and outputs."""

__all__ = ["checked", "have_one_order", "memory_error"]

from collections.abc import Collection, Sequence
from typing import Final

import numpy as np

from gsgen.runtime.errors import MemoryFull, SceneInvalid
from gsgen.runtime.gpu.splat_residency import bytes_of
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import OUTPUTS, Output
from gsgen.runtime.scene.scene import Scene

_LEVEL: Final = 1e-9  # of the distance of two eyes: how far they may be above or behind each other


def checked(
    scene: Scene, outputs: Collection[Output], background: Sequence[float], *, published: bool
) -> tuple[frozenset[Output], np.ndarray]:
    """Return a frame's outputs, and its background with the colour multiplied by alpha.

    Args:
        scene: The scene.
        outputs: Requested outputs.
        background: Red, green, blue and alpha of the background.
        published: See :class:`gsgen.runtime.renderer.renderer.Renderer`.

    Raises:
        SceneInvalid: ``outputs`` or ``background`` is invalid, or the scene if ``published``; or
            ``scene`` is of another type.
    """
    if not isinstance(scene, Scene):
        raise SceneInvalid(
            f"is of type {type(scene).__name__}, expected a Scene",
            where="scene",
            hint="Scene([SplatData.from_splats(gsgen.formats.open_splats(file))]) reads a file.",
        )
    requested = _known_outputs(outputs)
    if published:
        _require_only_weighted(scene)
    return requested, _premultiply_background(background)


def have_one_order(scene: Scene, left: Camera, right: Camera, outputs: frozenset[Output]) -> bool:
    """Return whether one sort of a scene's splats serves the images of both eyes.

    Eyes that look the same way, from places beside each other, see a splat at one z. Distances, as
    of a fisheye, differ; cells, pools and normals are drawn for one eye at a time.
    """
    shift = left.view[:3, :3] @ (right.eye - left.eye)
    return (
        np.array_equal(left.view[:3, :3], right.view[:3, :3])
        and bool(np.abs(shift[1:]).max() <= _LEVEL * abs(shift[0]))
        and (left.intrinsics, left.near, left.dilation)
        == (right.intrinsics, right.near, right.dilation)
        and left.kind == "pinhole"
        and "normal" not in outputs
        and not scene.pools
        and all(splat_set.weighted is None for splat_set in scene.sets)
    )


def memory_error(scene: Scene, camera: Camera, error: MemoryFull, *, compact: bool) -> MemoryFull:
    """Add the memory that the Gaussians take, and ways to need less, to an out-of-memory error."""
    sets = list(dict.fromkeys(splat_set.data for splat_set in scene.sets))
    now, memory_hint = (
        sum(bytes_of(splat_set, compact=is_compact) for splat_set in sets)
        for is_compact in (compact, True)
    )
    count = sum(map(len, sets))
    message = f"{error.message}; {count:,} Gaussians take {now:,} bytes"
    hint = "Draw fewer of them, or without harmonics: `gsgen convert --sh-degree 0`."
    if memory_hint < now:
        hint = f"With `--compact` (`compact=True`) they take {memory_hint:,}. {hint}"
    hint = f"{hint} A smaller image than {camera.width}×{camera.height} takes less, too."
    return MemoryFull(message, where=error.where, hint=hint)


def _require_only_weighted(scene: Scene) -> None:
    """Raise if a scene has meshes or depth-sorted sets besides weighted splat sets."""
    is_weighted = [splat_set.weighted is not None for splat_set in scene.sets]
    if any(is_weighted) and (scene.meshes or not all(is_weighted)):
        raise SceneInvalid(
            "is True, but the scene has depth-sorted sets or meshes, expected weighted sums alone",
            where="published",
            hint="Draw sorted sets and meshes with a renderer that has published=False.",
        )


def _known_outputs(outputs: Collection[Output]) -> frozenset[Output]:
    """Return the requested outputs of a frame; raise if the list is empty, or a name unknown."""
    requested = frozenset(outputs)
    if not requested or requested - set(OUTPUTS):
        raise SceneInvalid(
            f"is {sorted(requested)}, expected some of {', '.join(OUTPUTS)}", where="outputs"
        )
    return requested


def _premultiply_background(background: Sequence[float]) -> np.ndarray:
    """Return the background of a frame with its colour multiplied by alpha; raise if invalid."""
    color = np.asarray(background, np.float64)
    if color.shape != (4,) or not np.isfinite(color).all() or not 0 <= color[3] <= 1:
        raise SceneInvalid(
            f"is {list(background)}, expected red, green, blue and an alpha from 0 to 1",
            where="background",
        )
    return np.append(color[:3] * color[3], color[3])
