"""Test cases for viewers: a model, the frames to draw, and the viewer faults that they reveal."""

__all__ = [
    "COMMON_FAULTS",
    "COMMON_SH_FAULTS",
    "HEIGHT",
    "WIDTH",
    "KitCamera",
    "KitFrame",
    "ViewerKitCase",
    "kit_camera",
    "orbit_frame",
]

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from jaxtyping import Float

from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.contract.spec.geometry import look_at

WIDTH: Final = 64
"""Width of the pictures, in pixels."""

HEIGHT: Final = 48
"""Height of the pictures, in pixels."""

COMMON_FAULTS: Final = ("rows", "dilation", "encoded-twice")
"""The faults that spoil every case whose colours are sRGB."""

COMMON_SH_FAULTS: Final = (*COMMON_FAULTS, "sh-offset", "sh-stride")
"""The faults that spoil every case with SH of a degree below 3 and more than one row."""

_NEAR_PLANE_DISTANCE: Final = 0.01
_FOCAL_PIXELS: Final = 60.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KitCamera:
    """A pinhole camera with OpenCV axes, from which a test picture is drawn.

    Attributes:
        view: World → camera, which acts on column vectors.
        fx: Horizontal focal length, in pixels.
        fy: Vertical focal length, in pixels.
        cx: Principal point from the left edge, in pixels.
        cy: Principal point from the upper edge, in pixels.
        width: Width of the picture, in pixels.
        height: Height of the picture, in pixels.
        near: Distance of the near plane, in world units.
    """

    view: Float[np.ndarray, "4 4"]
    fx: float = _FOCAL_PIXELS
    fy: float = _FOCAL_PIXELS
    cx: float = WIDTH / 2
    cy: float = HEIGHT / 2
    width: int = WIDTH
    height: int = HEIGHT
    near: float = _NEAR_PLANE_DISTANCE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KitFrame:
    """One frame of a viewer test: the camera and the values of the model's inputs.

    Attributes:
        camera: The camera to draw from, which also feeds the model's camera inputs.
        values: Input name → value as the tensor holds it; an absent input has its default.
    """

    camera: KitCamera
    values: Mapping[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class ViewerKitCase:
    """A viewer test: a model, the frames to draw in order, and the viewer faults that they reveal.

    Attributes:
        name: The name, such as ``sh-degree-3``.
        tests: The behaviour of the viewer that the pictures depend on, in one sentence.
        faults: The ids of the faults that spoil a picture of this case.
        spec: The model.
        frames: The frames, in the order in which they are drawn in one session.
        breaks: The ids of the rules that the model breaks on purpose.
        slight: Those of ``faults`` whose difference is near the tolerance, so that a viewer with
            the fault may pass.
    """

    name: str
    tests: str
    faults: tuple[str, ...]
    spec: Callable[[], ModelSpec]
    frames: tuple[KitFrame, ...]
    breaks: tuple[str, ...] = ()
    slight: tuple[str, ...] = ()


def kit_camera(
    eye: tuple[float, float, float] = (1.2, -1.0, -2.6),
    target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    **lens: float,
) -> KitCamera:
    """Return a camera at ``eye`` that looks at ``target``; ``lens`` overrides intrinsics."""
    view = look_at(np.array(eye), np.array(target), np.array([0.0, -1.0, 0.0]))
    return KitCamera(view=view, **lens)  # type: ignore[arg-type]


def orbit_frame(**values: object) -> KitFrame:
    """Return a test frame from the default camera, with ``values`` by model input name."""
    arrays = {name: np.asarray(value) for name, value in values.items()}
    return KitFrame(camera=kit_camera(), values=arrays)
