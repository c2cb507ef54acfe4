"""Functions that declare frame inputs by input role; each returns an entry of the manifest.

The Visionary viewer binds the default names to the correct role.
"""

__all__ = [
    "appearance_id", "audio", "camera_position", "condition", "conditioning", "control",
    "expression", "frame_index", "image", "image_intrinsics", "image_views", "images", "pose", "projection", "root_rotation", "root_translation",
    "shape", "time", "timestep", "view", "viewport",
]  # fmt: skip

from collections.abc import Sequence
from typing import Literal

from gsgen.contract.spec.manifest import Input, Joint
from gsgen.sdk.errors import GeneratorInvalid

Range = tuple[float, float]


def view(name: str = "camera") -> Input:
    """Declare the input for the view matrix (world→camera), float32 [4, 4]."""
    return Input(name=name, role="view", shape=(4, 4), default="identity")


def projection(name: str = "proj") -> Input:
    """Declare the input for the projection matrix (camera→clip, depth 0..1), float32 [4, 4]."""
    return Input(name=name, role="projection", shape=(4, 4), default="identity")


def time(
    name: str = "time",
    *,
    range: Range = (0.0, 1.0),
    loop: bool | None = None,
    frames: int | None = None,
    fps: float | None = None,
) -> Input:
    """Declare the input for the animation time, float32 [1].

    Args:
        name: The tensor's name.
        range: First and last moment, in the model's own unit.
        loop: Whether the end continues at the start.
        frames: Number of distinct frames.
        fps: Frames per second at natural speed.
    """
    low, high = float(range[0]), float(range[1])
    return Input(
        name=name,
        role="time",
        shape=(1,),
        range=(low, high),
        default=low,
        loop=loop,
        frames=frames,
        fps=fps,
    )


def frame_index(frames: int, name: str = "frame_index") -> Input:
    """Declare the input for the frame number, int32 [1], from 0 to ``frames`` − 1."""
    return Input(
        name=name, role="frame_index", shape=(1,), range=(0, frames - 1), default=0, frames=frames
    )


def camera_position(name: str = "camera_position") -> Input:
    """Declare the input for the camera centre in local space, float32 [3]."""
    return Input(name=name, role="camera_position", shape=(3,), default="zeros")


def viewport(name: str = "viewport") -> Input:
    """Declare the input for width and height of the image in pixels, float32 [2]."""
    return Input(name=name, role="viewport", shape=(2,), default=(1280.0, 720.0))


def pose(
    joints: int,
    name: str = "pose",
    *,
    convention: Literal[
        "smpl-axis-angle", "axis-angle", "quaternion-wxyz", "flame", "mano"
    ] = "axis-angle",
    range: Range = (-3.1416, 3.1416),
    skeleton: Sequence[Joint] = (),
) -> Input:
    """Declare the input for joint rotations: [joints, 3] axis-angle or [joints, 4] quaternions.

    Args:
        joints: Number of joints; 5 for ``flame``, 16 for ``mano``.
        name: The tensor's name.
        convention: Meaning and order of the rotations.
        range: Smallest and largest value, in radians.
        skeleton: Name, parent and rest position of each joint, for tools that retarget motion.
    """
    quaternions = convention == "quaternion-wxyz"
    return Input(
        name=name,
        role="pose",
        shape=(joints, 4 if quaternions else 3),
        range=(-1.0, 1.0) if quaternions else range,
        default="identity" if quaternions else "zeros",
        convention=convention,
        joints=tuple(skeleton),
    )


def shape(
    count: int,
    name: str = "shape",
    *,
    range: Range = (-3.0, 3.0),
    convention: Literal["flame", "mano", "smplx-10"] | None = None,
) -> Input:
    """Declare the input for the shape coefficients of a body model, float32 [count]."""
    return Input(
        name=name, role="shape", shape=(count,), range=range, default="zeros", convention=convention
    )


def root_translation(name: str = "root_translation", *, range: Range = (-1.0, 1.0)) -> Input:
    """Declare the input for the translation of a body's root in local units, float32 [3]."""
    return Input(name=name, role="root_translation", shape=(3,), range=range, default="zeros")


def root_rotation(
    name: str = "root_rotation", *, convention: Literal["axis-angle", "matrix"] = "axis-angle"
) -> Input:
    """Declare the input for a body's root rotation: float32 [3] axis-angle or [3, 3] matrix."""
    if convention == "matrix":
        return Input(
            name=name, role="root_rotation", shape=(3, 3), default="identity", convention=convention
        )
    return Input(
        name=name,
        role="root_rotation",
        shape=(3,),
        range=(-3.1416, 3.1416),
        default="zeros",
        convention=convention,
    )


def expression(
    count: int,
    name: str = "expression",
    *,
    range: Range | None = None,
    convention: Literal["flame", "arkit-52", "smplx-10"] | None = None,
) -> Input:
    """Declare the input for the expression coefficients of a face model, float32 [count].

    The range is [0, 1] for ``arkit-52`` and [−2, 2] otherwise, unless it is given.
    """
    default_range = (0.0, 1.0) if convention == "arkit-52" else (-2.0, 2.0)
    return Input(
        name=name,
        role="expression",
        shape=(count,),
        range=range or default_range,
        default="zeros",
        convention=convention,
    )


def audio(
    rate: float,
    *,
    samples: int | None = None,
    mel: tuple[int, int] | None = None,
    window: int | None = None,
    hop: int | None = None,
    name: str = "audio",
) -> Input:
    """Declare the input for sound: float32 [samples], or [columns, bands] of mel energies.

    Args:
        rate: Samples per second.
        samples: Number of samples, each in [−1, 1].
        mel: Number of columns and of bands, in place of samples.
        window: Samples under the window of one column.
        hop: Samples from one column to the next.
        name: The tensor's name.

    Raises:
        GeneratorInvalid: Both or neither of ``samples`` and ``mel`` are given.
    """
    if (samples is None) == (mel is None):
        hint = "Give samples=160, or mel=(columns, bands)."
        raise GeneratorInvalid(
            "the sound input has both or neither of samples and mel, expected one of them",
            where="inputs.audio",
            hint=hint,
        )
    return Input(
        name=name,
        role="audio",
        shape=mel or (samples or 1,),
        range=(-1.0, 1.0) if mel is None else None,
        default="zeros",
        convention="mel" if mel else "samples",
        rate=rate,
        window=window,
        hop=hop,
    )


def condition(
    size: int | tuple[int, ...],
    name: str = "condition",
    *,
    range: Range = (-3.0, 3.0),
    scene: bool = False,
) -> Input:
    """Declare the input for numbers that another program computes, such as the code of a text.

    Args:
        size: How many there are, or the shape of the tensor, such as (77, 768).
        name: The tensor's name.
        range: Smallest and largest value.
        scene: Whether it stays from frame to frame, so that a runtime computes what depends on it
            once (the scene pass).
    """
    shape = (size,) if isinstance(size, int) else tuple(size)
    return Input(
        name=name,
        role="condition",
        shape=shape,
        range=range,
        default="zeros",
        pass_="scene" if scene else None,
    )


def images(
    count: int,
    size: tuple[int, int],
    name: str = "image",
    *,
    range: Range = (0.0, 1.0),
    background: tuple[float, float, float] | None = None,
) -> Input:
    """Declare the input of pictures that Gaussians are computed from, [count, 3, height, width].

    Args:
        count: Number of pictures.
        size: Height and width.
        name: The tensor's name.
        range: Values of black and white.
        background: RGB from 0 to 1 under transparent pixels; black if absent.
    """
    return Input(
        name=name, role="image", shape=(count, 3, *size), range=range, background=background
    )


def image_views(count: int, name: str = "image_view") -> Input:
    """Declare the input for the pictures' view matrices (world→camera), float32 [count, 4, 4]."""
    return Input(name=name, role="image_view", shape=(count, 4, 4), default="identity")


def image_intrinsics(
    count: int, name: str = "image_intrinsics", *, default: tuple[float, float, float, float]
) -> Input:
    """Declare the input for the pictures' pinhole matrices in pixels, float32 [count, 3, 3].

    Args:
        count: Number of pictures.
        name: The tensor's name.
        default: Focal lengths in x and y and principal point of pictures without known cameras,
            in pixels of the input of pictures.
    """
    fx, fy, cx, cy = map(float, default)
    matrix = (fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0)
    return Input(name=name, role="image_intrinsics", shape=(count, 3, 3), default=matrix * count)


def appearance_id(count: int, name: str = "appearance_id") -> Input:
    """Declare the input that selects one of ``count`` learned appearances, int32 [1]."""
    return Input(name=name, role="appearance_id", shape=(1,), range=(0, count - 1), default=0)


def control(
    name: str, *, range: Range, default: float, size: int = 1, label: str | None = None
) -> Input:
    """Declare the input whose value a named slider of the viewer sets, float32 [size]."""
    return Input(
        name=name, role="control", shape=(size,), range=range, default=default, label=label
    )


def image(
    channels: int = 3,
    size: tuple[int, int] | None = None,
    name: str = "image",
    *,
    range: Range = (0.0, 1.0),
) -> Input:
    """Declare the input of a post-process model: the rendered image, [1, channels, height, width].

    Args:
        channels: 3, or 4 with alpha.
        size: Height and width; open if absent.
        name: The tensor's name.
        range: Values of black and white.
    """
    shape = None if size is None else (1, channels, *size)
    return Input(name=name, role="image", shape=shape, range=range)


def timestep(default: float, name: str = "timestep", *, range: Range = (0, 999)) -> Input:
    """Declare the input for the diffusion timestep of a post-process model, float32 [1]."""
    low, high = float(range[0]), float(range[1])
    return Input(name=name, role="timestep", shape=(1,), range=(low, high), default=float(default))


def conditioning(rows: int, width: int, name: str = "conditioning") -> Input:
    """Declare a post-process model's input of conditioning vectors, float32 [1, rows, width]."""
    return Input(
        name=name, role="conditioning", shape=(1, rows, width), range=(-3.0, 3.0), default="zeros"
    )
