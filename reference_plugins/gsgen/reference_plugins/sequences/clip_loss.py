"""Measures the loss of a clip: drawn moments against the source's, at frames and between them."""

__all__ = ["camera_around", "draw_rows", "measure_loss"]

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from jaxtyping import Float32

from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import GeneratorManifest, Manifest
from gsgen.runtime.baking.fidelity import renderer_or_none
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import psnr
from gsgen.runtime.scene.scene import Scene
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.framing import box_around, union_of_boxes
from gsgen.sdk.binding.frame import Frame
from gsgen.sdk.binding.session import FrameSession
from gsgen.sdk.exporting.constant_generator import ConstantRows
from gsgen.sdk.sequences.clip_source import FrameReader
from gsgen.sdk.sequences.correspondence import rows_correspond
from gsgen.sdk.sequences.frame_store import cholesky_factors, covariance_of
from gsgen.tiles.scoring.ssim import ssim

if TYPE_CHECKING:
    from gsgen.runtime.renderer.renderer import Renderer

_SIZE: Final = (320, 240)
_FOV: Final = 50.0
_VIEW_DIRECTION: Final = np.array([0.5, -0.3, -1.0])
# How far the camera is, in diagonals of the box that it looks at.
_DISTANCE: Final = 1.1
# Equal pictures have no finite ratio.
_EQUAL_PICTURES_DB: Final = 99.0


def measure_loss(
    path: Path, read: FrameReader, names: Sequence[str], moments: int
) -> tuple[Mapping[str, Any], tuple[str, ...]]:
    """Draw a clip and its source at moments, and return PSNR and SSIM as numbers and as lines.

    Half of the moments are frames, half are midway between two frames, where the source is
    interpolated: centres, opacities, base colours and Cholesky factors.

    Args:
        path: The model.
        read: Reads a frame of the source.
        names: Names of the frames.
        moments: How many moments are drawn.
    """
    renderer, reason = renderer_or_none()
    if renderer is None:
        return {"loss": None}, (f"loss not measured: {reason}",)
    count = len(names)
    frames = np.unique(np.linspace(0, count - 1, -(-moments // 2)).round().astype(int))
    between = np.unique(np.linspace(0, count - 2, max(1, moments // 2)).round().astype(int)) + 0.5
    rows = []
    with FrameSession(path, provider="cpu") as session:
        camera = camera_around([read(number) for number in (0, count // 2, count - 1)])
        for place in (*frames.tolist(), *between.tolist()):
            source = _source_moment(read, place)
            if source is None:
                continue
            moment = place / _frames(session.manifest)
            frame = session.run({"time": np.array([moment], np.float32)}, copy=True)
            played = _played(frame, session.manifest, source)
            pictures = [draw_rows(renderer, moment, camera) for moment in (played, source)]
            ratio = min(psnr(*pictures), _EQUAL_PICTURES_DB)
            similarity = ssim(*pictures)
            rows.append({"frame": place, "psnr": round(ratio, 2), "ssim": round(similarity, 5)})
    worst = min(rows, key=lambda row: row["psnr"])
    mean = float(np.mean([row["psnr"] for row in rows]))
    document = {
        "moments": rows,
        "psnr_mean": round(mean, 2),
        "psnr_worst": worst["psnr"],
        "ssim_mean": round(float(np.mean([row["ssim"] for row in rows])), 5),
        "worst_frame": names[int(worst["frame"])],
    }
    is_between = worst["frame"] % 1 != 0
    where = f"{'after ' if is_between else ''}{document['worst_frame']}"
    line = (
        f"drawn at {len(frames)} frames and {len(rows) - len(frames)} moments between: PSNR {mean:.1f} dB, "
        f"SSIM {document['ssim_mean']:.4f}; worst {worst['psnr']:.1f} dB, {where}"
    )
    return {"loss": document}, (line,)


def _frames(manifest: Manifest | None) -> int:
    assert isinstance(manifest, GeneratorManifest)
    (time,) = manifest.inputs
    assert time.frames is not None
    return time.frames


def camera_around(frames: Sequence[ConstantRows]) -> Camera:
    """Return the camera of 320 × 240 pixels that sees all Gaussians of some frames."""
    box = union_of_boxes([box_around(_splat_data(frame)) for frame in frames])
    low, high = (np.zeros(3), np.ones(3)) if box is None else box
    centre, reach = (low + high) / 2, max(float(np.linalg.norm(high - low)), 1e-6)
    eye = centre + _VIEW_DIRECTION * _DISTANCE * reach
    width, height = _SIZE
    return Camera.look_at(tuple(eye), tuple(centre), width=width, height=height, fov_y=_FOV)


def _source_moment(read: FrameReader, place: float) -> ConstantRows | None:
    """Return the source at a frame, or interpolated between two frames whose rows correspond."""
    low = int(place)
    first, part = read(low), place - low
    if not part:
        return first
    second = read(low + 1)
    if not rows_correspond(first, second):
        return None
    rows = (1 - part) * first.rows + part * second.rows
    factors = [cholesky_factors(frame.rows[:, layout.COVARIANCE]) for frame in (first, second)]
    between = (1 - part) * factors[0] + part * factors[1]
    rows[:, layout.COVARIANCE] = covariance_of(between.T).T
    appearance = (1 - part) * first.appearance + part * second.appearance
    return _with_rows(first, rows, appearance)


def _played(frame: Frame, manifest: Manifest | None, source: ConstantRows) -> ConstantRows:
    assert isinstance(manifest, GeneratorManifest)
    outputs = manifest.outputs
    assert outputs.gaussians is not None
    assert outputs.appearance is not None
    return _with_rows(source, frame[outputs.gaussians.name], frame[outputs.appearance.name])


def _with_rows(frame: ConstantRows, rows: np.ndarray, appearance: np.ndarray) -> ConstantRows:
    return replace(
        frame,
        rows=np.ascontiguousarray(rows, np.float32),
        appearance=np.ascontiguousarray(appearance, np.float32),
    )


def _splat_data(frame: ConstantRows) -> SplatData:
    return SplatData(
        np.ascontiguousarray(frame.rows, np.float32),
        np.ascontiguousarray(frame.appearance, np.float32),
        frame.space,
        antialias=frame.antialias,
    )


def draw_rows(
    renderer: "Renderer", frame: ConstantRows, camera: Camera
) -> Float32[np.ndarray, "h w 3"]:
    """Draw the rows of a frame before black; colours are clipped to 0 and 1."""
    scene = Scene([_splat_data(frame)], color_space=frame.color_space)
    rgba = renderer.render(scene, camera, background=(0, 0, 0, 1)).rgba
    assert rgba is not None  # colours are rendered by default
    return np.asarray(np.clip(rgba[..., :3], 0, 1))
