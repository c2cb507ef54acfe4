"""Input roles: the meaning of a model input, which fixes the input's shape and dtype."""

__all__ = [
    "CAMERA_ROLES",
    "CONVENTION_SHAPES",
    "IMAGE_CHANNELS",
    "JOINTS",
    "MATRIX_ROLES",
    "PICTURE_ROLES",
    "ROLES",
    "ROTATION_ROLES",
    "STATE_SIZES",
    "Role",
    "Shape",
    "matches_shape",
    "matching_shape",
    "role",
    "shapes_of",
]

from dataclasses import dataclass

from gsgen.contract.errors import UnknownName

# A dimension is a fixed size or the name of a size that the manifest declares.
Shape = tuple[int | str, ...]

GENERATOR = "gaussian-generator"
POST_PROCESS = "post-process"
TRAJECTORY = "trajectory-predictor"
MANIFEST_KINDS = (GENERATOR, POST_PROCESS, TRAJECTORY)

# Roles of the camera: they cull, fade and light, and from some places change nothing.
CAMERA_ROLES = ("view", "projection", "camera_position", "viewport")

# Roles of the pictures that a generator computes its Gaussians from: inputs of its scene pass.
PICTURE_ROLES = ("image", "image_view", "image_intrinsics")

# Roles of [4, 4] matrices, stored in the memory order that the manifest declares.
MATRIX_ROLES = ("view", "projection", "image_view")

# Roles whose numbers are rotations, as angles, quaternions or matrices.
ROTATION_ROLES = ("pose", "root_rotation")

STATE_SIZES = {"position+quaternion-wxyz": 7, "position+axis-angle": 6}
"""Numbers in a camera state by its representation: the centre, then the rotation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Role:
    """An input role, such as ``view`` or ``time``: meaning, allowed shapes and dtype.

    Attributes:
        name: The word the manifest uses.
        dtype: The dtypes it may have; the first is the usual one.
        shapes: The shapes it may have; a word stands for a size that the model fixes.
        summary: One sentence for people.
        kinds: The kinds of model that may take it.
        index: It counts things (frames, identities), so values are whole numbers.
        needs_range: Sampling it makes no sense unless the manifest declares a range.
        conventions: What ``convention`` may say, where the role has more than one.
    """

    name: str
    dtype: tuple[str, ...]
    shapes: tuple[Shape, ...]
    summary: str
    kinds: tuple[str, ...] = (GENERATOR,)
    index: bool = False
    needs_range: bool = False
    conventions: tuple[str, ...] = ()


# The numbers of channels of an image: RGB, and RGB with alpha.
IMAGE_CHANNELS = (3, 4)

# The numbers of joints of the body models whose order a convention of `pose` names.
JOINTS: dict[str, tuple[int, ...]] = {"smpl-axis-angle": (24, 55)}

_FLOAT_DTYPES = ("float32",)
_INDEX_DTYPES = ("int32",)

ROLES: dict[str, Role] = {
    entry.name: entry
    for entry in (
        Role(
            name="view",
            dtype=_FLOAT_DTYPES,
            shapes=((4, 4),),
            summary="World→camera matrix; memory order as declared.",
        ),
        Role(
            name="projection",
            dtype=_FLOAT_DTYPES,
            shapes=((4, 4),),
            summary="Camera→clip matrix, depth 0..1.",
        ),
        Role(
            name="time", dtype=_FLOAT_DTYPES, shapes=((1,),), summary="Time, in the declared range."
        ),
        Role(
            name="frame_index",
            dtype=_INDEX_DTYPES,
            shapes=((1,),),
            summary="Frame number.",
            index=True,
            needs_range=True,
        ),
        Role(
            name="camera_position",
            dtype=_FLOAT_DTYPES,
            shapes=((3,),),
            summary="Camera centre, in local space.",
        ),
        Role(
            name="viewport",
            dtype=_FLOAT_DTYPES,
            shapes=((2,),),
            summary="Width and height of the image, in pixels.",
        ),
        Role(
            name="pose",
            dtype=_FLOAT_DTYPES,
            shapes=(("J", 3), ("J", 4)),
            summary="Joint rotations, axis-angle [J,3] in radians or quaternions (w,x,y,z) [J,4].",
            conventions=("smpl-axis-angle", "axis-angle", "quaternion-wxyz", "flame", "mano"),
        ),
        Role(
            name="shape",
            dtype=_FLOAT_DTYPES,
            shapes=(("B",),),
            summary="Body shape coefficients.",
            needs_range=True,
            conventions=("flame", "mano", "smplx-10"),
        ),
        Role(
            name="root_translation",
            dtype=_FLOAT_DTYPES,
            shapes=((3,),),
            summary="Translation of the root, in local units.",
        ),
        Role(
            name="root_rotation",
            dtype=_FLOAT_DTYPES,
            shapes=((3,), (3, 3)),
            summary="Rotation of the root, axis-angle [3] in radians or matrix [3,3].",
            conventions=("axis-angle", "matrix"),
        ),
        Role(
            name="expression",
            dtype=_FLOAT_DTYPES,
            shapes=(("E",),),
            summary="Expression coefficients.",
            needs_range=True,
            conventions=("flame", "arkit-52", "smplx-10"),
        ),
        Role(
            name="appearance_id",
            dtype=_INDEX_DTYPES,
            shapes=((1,),),
            summary="Appearance.",
            index=True,
            needs_range=True,
        ),
        Role(
            name="audio",
            dtype=_FLOAT_DTYPES,
            shapes=(("S",), ("W", "M")),
            summary="Sound: S samples in [−1, 1], or W columns of M mel energies; newest last.",
            conventions=("samples", "mel"),
        ),
        Role(
            name="condition",
            dtype=("float32", "int32"),
            shapes=(("*",),),
            summary="Numbers that another program computes, such as the tokens or the code of a text.",
            needs_range=True,
        ),
        Role(
            name="control",
            dtype=_FLOAT_DTYPES,
            shapes=(("*",),),
            summary="A named slider.",
            kinds=(GENERATOR, POST_PROCESS),
            needs_range=True,
        ),
        Role(
            name="image",
            dtype=("float32", "float16"),
            shapes=((1, 3, "H", "W"), (1, 4, "H", "W")),
            summary="Pictures, channels first: of the scene, or the rendered one.",
            kinds=(GENERATOR, POST_PROCESS),
        ),
        Role(
            name="image_view",
            dtype=_FLOAT_DTYPES,
            shapes=(("V", 4, 4),),
            summary="World→camera matrix of each picture; memory order as declared.",
        ),
        Role(
            name="image_intrinsics",
            dtype=_FLOAT_DTYPES,
            shapes=(("V", 3, 3),),
            summary="Pinhole matrix of each picture, in pixels of the `image` input.",
        ),
        Role(
            name="timestep",
            dtype=("int32", "float32"),
            shapes=((1,),),
            summary="Diffusion timestep.",
            kinds=(POST_PROCESS,),
            needs_range=True,
        ),
        Role(
            name="conditioning",
            dtype=("float32", "float16"),
            shapes=((1, "L", "D"), (1, "D")),
            summary="Conditioning vectors, such as a text embedding.",
            kinds=(POST_PROCESS,),
        ),
        Role(
            name="camera_history",
            dtype=_FLOAT_DTYPES,
            shapes=(("T", "S"),),
            summary="Past camera states, oldest first.",
            kinds=(TRAJECTORY,),
        ),
    )
}


# (Role, kind) → the shapes that the role has in that kind of model, where they differ.
_SHAPES_BY_KIND: dict[tuple[str, str], tuple[Shape, ...]] = {
    ("image", GENERATOR): (("V", 3, "H", "W"),)
}

# (Role, convention) → the shape that it fixes, where the role leaves sizes open.
CONVENTION_SHAPES: dict[tuple[str, str], Shape] = {
    ("pose", "flame"): (5, 3),
    ("pose", "mano"): (16, 3),
    ("shape", "flame"): ("B",),
    ("shape", "mano"): (10,),
    ("shape", "smplx-10"): (10,),
    ("expression", "flame"): ("E",),
    ("expression", "arkit-52"): (52,),
    ("expression", "smplx-10"): (10,),
    ("audio", "samples"): ("S",),
    ("audio", "mel"): ("W", "M"),
}


def role(name: str) -> Role:
    """Return the input role called ``name``.

    Raises:
        UnknownName: No role has that name; the message names the nearest one.
    """
    if name not in ROLES:
        raise UnknownName.among("role", name, ROLES)
    return ROLES[name]


def shapes_of(entry: Role, kind: str) -> tuple[Shape, ...]:
    """Return the shapes that an input role may have in a kind of model."""
    return _SHAPES_BY_KIND.get((entry.name, kind), entry.shapes)


def matching_shape(entry: Role, dims: Shape, kind: str = "") -> Shape | None:
    """Return the first shape of an input role that a tensor's dimensions match, or None.

    A named size fits any positive number; ``*`` alone fits any shape.
    """
    for shape in shapes_of(entry, kind):
        if shape == ("*",):
            return shape
        if matches_shape(shape, dims):
            return shape
    return None


def matches_shape(shape: Shape, dims: Shape) -> bool:
    """Return whether dimensions match an input role's shape; a symbolic size matches any."""
    return len(shape) == len(dims) and all(
        isinstance(expected, str) or expected == dim
        for expected, dim in zip(shape, dims, strict=True)
    )
