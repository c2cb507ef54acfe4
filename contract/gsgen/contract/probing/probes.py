"""Probes: deterministic test inputs for a model, the same on every machine.

Cameras orbit the declared bounds, times cover the declared range with both ends, and every
other input is sampled within its range. The first probe is all zeros, which is what runtimes
feed before the first real values.
"""

__all__ = [
    "INPUT_PREFIX",
    "ORBIT_RADII",
    "Array",
    "CameraPlacement",
    "Probe",
    "SceneExtent",
    "as_tensor",
    "cast_array",
    "default_probes",
    "dependency_probes",
    "straight_path",
    "turning_path",
]

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gsgen.contract._array_types import Float
from gsgen.contract.spec.fields.roles import PICTURE_ROLES, ROLES, STATE_SIZES
from gsgen.contract.spec.geometry import (
    look_at,
    perspective,
    quaternion_product,
    rotation_quaternion,
    rotation_vector,
)
from gsgen.contract.spec.manifest import Bounds, GeneratorManifest, Input, Manifest

Array = np.ndarray

# Start of the key of one input, among those of roles.
INPUT_PREFIX = "input "

# Images wide, square and tall, and lenses from the narrower to the wider angle: a model that
# depends on either must show it.
_VIEWPORT_SIZES = ((1280.0, 720.0), (960.0, 960.0), (720.0, 1280.0))
_FOV_RANGE = (np.deg2rad(50.0), np.deg2rad(70.0))
_NEAR_PLANE_DISTANCE, _FAR_PLANE_DISTANCE = 0.01, 1000.0
# Bounds beyond this count as unknown; its square is still a finite float32.
_MAX_COORDINATE = 1e18
# Distance of probe cameras from the centre, in half diagonals of the bounds.
ORBIT_RADII = 2.2
# The least extent of a camera path that is made, also as a share of the distance from the origin, and
# the share of a declared range that it crosses where it would leave it.
_MIN_PATH_EXTENT, _MIN_PATH_SHARE, _RANGE_SHARE = 0.1, 1e-3, 0.75
_UP_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPlacement:
    """Instruction to move a test camera to the centre of a Gaussian that an earlier run computed.

    Attributes:
        rows: The output of packed rows, whose first visible row is taken.
        order: Memory order of the view matrix.
        view: The input with the view matrix; empty if the model lacks it.
        position: The input with the camera's centre; empty if the model lacks it.
    """

    rows: str
    order: str
    view: str = ""
    position: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Probe:
    """A probe: one set of test inputs for a model, with a label.

    Attributes:
        label: Its name in reports, such as ``camera 3, time=0.5``.
        inputs: Input name → array.
        zeros: Whether every input is zero.
        extra: Whether only behaviour rules use it: a part of its outputs is stored, and its
            failure is not a failure of the model.
        optimise: Whether ONNX Runtime may rewrite the graph.
        survey: Whether only the digest and the extremes of the outputs are kept, and no rows.
        pictured: Whether the drawn rows of a survey probe are kept for pictures.
        placement: Where the sandbox moves the camera, if that depends on an earlier run.
    """

    label: str
    inputs: dict[str, Array]
    zeros: bool = False
    extra: bool = False
    optimise: bool = True
    survey: bool = False
    pictured: bool = False
    placement: CameraPlacement | None = None


def default_probes(
    manifest: Manifest,
    shapes: dict[str, tuple[int, ...]],
    dtypes: dict[str, str],
    seed: int = 0,
    count: int = 8,
) -> tuple[Probe, ...]:
    """Return the deterministic test inputs (probes) of a model.

    Args:
        manifest: Declares the role and the range of each input.
        shapes: Input name → static shape.
        dtypes: Input name → dtype in the graph.
        seed: Another seed gives another set.
        count: Number of probes besides the all-zero one; at least 2.

    A model without inputs has one probe.
    """
    if not manifest.inputs:
        return (Probe(label="no inputs", inputs={}),)
    zero_inputs = {i.name: np.zeros(shapes[i.name], dtypes[i.name]) for i in manifest.inputs}
    probes = [Probe(label="all inputs zero", inputs=zero_inputs, zeros=True)]
    for index in range(count):
        rng = np.random.default_rng([seed, index])
        range_fraction = index / (count - 1)
        size = _picture_size(manifest, shapes)
        inputs = {
            i.name: cast_array(
                _sample_picture_input(i, manifest, shapes[i.name], size, range_fraction, rng)
                if i.role in PICTURE_ROLES and isinstance(manifest, GeneratorManifest)
                else _sample_input(i, manifest, shapes[i.name], range_fraction, rng),
                dtypes[i.name],
            )
            for i in manifest.inputs
        }
        probes.append(Probe(label=_probe_label(manifest, inputs, index), inputs=inputs))
    return tuple(probes)


def dependency_probes(
    manifest: Manifest, base: Probe, other_probes: tuple[Probe, ...]
) -> Iterator[tuple[str, tuple[Probe, ...]]]:
    """Yield per input role, such as time, test inputs that differ from a base set in it alone.

    An input that ``depends_on`` names has probes of its own, under the key ``input NAME``.
    """
    groups: dict[str, list[str]] = {role: [] for role in sorted({i.role for i in manifest.inputs})}
    for entry in manifest.inputs:
        groups[entry.role].append(entry.name)
    if isinstance(manifest, GeneratorManifest):
        inputs = [entry.name for entry in manifest.inputs if entry.name in manifest.depends_on]
        groups |= {f"{INPUT_PREFIX}{name}": [name] for name in inputs}
    for name, changed_names in groups.items():
        variants = tuple(
            Probe(
                label=f"{base.label} with the {name} of {variant.label}",
                inputs=base.inputs | {key: variant.inputs[key] for key in changed_names},
            )
            for variant in other_probes
        )
        yield name, variants


def as_tensor(matrix: Float[np.ndarray, "4 4"], order: str) -> Float[np.ndarray, "4 4"]:
    """Return a matrix as a [4, 4] tensor in row-major or (transposed) column-major order."""
    tensor = matrix.T if order == "column" else matrix
    return np.ascontiguousarray(tensor, np.float32)


# The annotation of a generator is quoted: NumPy loads its random module when it is named.
def _sample_input(
    spec: Input,
    manifest: Manifest,
    shape: tuple[int, ...],
    range_fraction: float,
    rng: "np.random.Generator",
) -> Array:
    space = manifest.space if isinstance(manifest, GeneratorManifest) else None
    order = space.matrix_order if space else "column"
    if spec.role == "view":
        return as_tensor(_camera(manifest, range_fraction), order)
    if spec.role == "projection":
        return as_tensor(_projection_at_fraction(range_fraction), order)
    if spec.role == "camera_position":
        view = _camera(manifest, range_fraction)
        return np.asarray(-view[:3, :3].T @ view[:3, 3])
    if spec.role == "viewport":
        return np.asarray(_viewport_at_fraction(range_fraction))
    if spec.role == "camera_history" and len(shape) == 2 and shape[1] in STATE_SIZES.values():
        return _random_camera_history(spec.range or (-1.0, 1.0), shape[0], shape[1], rng)
    low, high = spec.range or _default_range(spec)
    if spec.role in ("time", "frame_index", "appearance_id", "timestep"):
        value = _interpolate(low, high, np.asarray(range_fraction))  # includes both ends
        return np.full(shape, np.rint(value) if ROLES[spec.role].index else value)
    if spec.role in ("pose", "root_rotation") and shape[-1] == 4:
        quaternion = rng.normal(size=shape)
        return np.asarray(quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True))
    if spec.role == "root_rotation" and shape == (3, 3):
        q, r = np.linalg.qr(rng.normal(size=(3, 3)))
        q = q * np.sign(np.diag(r))
        return np.asarray(q * np.linalg.det(q))
    return _interpolate(low, high, rng.random(shape))


def _picture_size(manifest: Manifest, shapes: dict[str, tuple[int, ...]]) -> tuple[int, int]:
    """Return height and width of the model's first input of pictures; 1 without any."""
    sizes = (shapes[entry.name][-2:] for entry in manifest.inputs if entry.role == "image")
    return next(((size[0], size[1]) for size in sizes if len(size) == 2), (1, 1))


def _sample_picture_input(
    spec: Input,
    manifest: GeneratorManifest,
    shape: tuple[int, ...],
    size: tuple[int, int],
    range_fraction: float,
    rng: "np.random.Generator",
) -> Array:
    """Return test pictures, or the cameras of pictures of a size (height, width) in pixels."""
    from gsgen.contract.probing.picture_probes import (
        intrinsics_of_pictures,
        synthetic_pictures,
        views_of_pictures,
    )

    count = shape[0] if shape else 1
    if spec.role == "image_view" and shape[1:] == (4, 4):
        # Gaussians may stand where these cameras look, so bounds cannot place the cameras.
        unbounded = replace(manifest, bounds=None)
        views = views_of_pictures(count, range_fraction, lambda place: _camera(unbounded, place))
        is_transposed = manifest.space is None or manifest.space.matrix_order == "column"
        return np.asarray(views.swapaxes(1, 2) if is_transposed else views)
    if spec.role == "image_intrinsics" and shape[1:] == (3, 3):
        min_fov, max_fov = _FOV_RANGE
        field_of_view = min_fov + (max_fov - min_fov) * range_fraction
        return intrinsics_of_pictures(count, size, field_of_view)
    low, high = spec.range or (0.0, 1.0)
    return _interpolate(low, high, synthetic_pictures(shape, rng))


def _random_camera_history(
    span: tuple[float, float], count: int, size: int, rng: "np.random.Generator"
) -> Float[np.ndarray, "t s"]:
    """Return a smooth camera path for test inputs: one row per step, with centre and rotation."""
    steps = np.arange(count)[:, None]
    path_ends = _interpolate(*span, rng.random((2, 3)))
    step_length = (path_ends[1] - path_ends[0]) / max(count - 1, 1)
    position = path_ends[0] + step_length * steps * rng.uniform(0.2, 0.8)
    first, last = rng.normal(size=(2, size - 3))
    if size == STATE_SIZES["position+axis-angle"]:
        return np.hstack([position, first / 2 + steps * last / (8 * count)])
    rotation = first / np.linalg.norm(first) + steps * last / (8 * count)
    return np.hstack([position, rotation / np.linalg.norm(rotation, axis=1, keepdims=True)])


def straight_path(
    camera_history: Array,
    direction: Float[np.ndarray, " 3"],
    speed: float = 1.0,
    span: tuple[float, float] | None = None,
) -> Array:
    """Return a path of constant velocity without a turn, which ends at another's newest state.

    Args:
        camera_history: The other path, whose extent it has.
        direction: Of the motion, of length 1.
        speed: The extent is multiplied by it.
        span: The declared range of positions, in whose middle a path lies that would leave it.
    """
    positions = camera_history[:, :3].astype(np.float64)
    # Far from the origin, float32 tells only long steps.
    least = max(_MIN_PATH_EXTENT, _MIN_PATH_SHARE * float(np.abs(positions).max(initial=0)))
    extent = speed * max(float(np.ptp(positions, axis=0).max(initial=0)), least)
    path, ahead = np.repeat(camera_history[-1:], len(camera_history), axis=0), 0.0
    if span is not None and extent > (widest := _RANGE_SHARE * (span[1] - span[0])):
        path[:, :3], ahead, extent = sum(span) / 2, 0.5, widest
    steps = np.linspace(-1, 0, len(path)) + ahead
    path[:, :3] += steps[:, None] * direction * extent
    return path


def turning_path(
    camera_history: Array,
    turn: Float[np.ndarray, " 3"],
    start: Float[np.ndarray, " 4"] | None = None,
) -> Array:
    """Return a path that rests at another's newest place and turns by the same angle each step.

    Args:
        camera_history: The other path, [T, 7] or [T, 6].
        turn: Axis times angle of a step, in radians.
        start: The newest rotation as a quaternion (w, x, y, z); that of the other path if absent.
    """
    path = np.repeat(camera_history[-1:], len(camera_history), axis=0)
    has_vectors = path.shape[1] == STATE_SIZES["position+axis-angle"]
    if start is None:
        start = rotation_quaternion(path[-1, 3:]) if has_vectors else path[-1, 3:]
    # By the angle from the newest state back, so that the sign continues over a whole circle.
    steps = np.arange(len(path))[:, None] - (len(path) - 1)
    turns = rotation_quaternion(steps * turn)
    rotations = np.stack([quaternion_product(step, start) for step in turns])
    path[:, 3:] = rotation_vector(rotations) if has_vectors else rotations
    return path


def _interpolate(low: float, high: float, range_fraction: Array) -> Array:
    """Interpolate linearly between two numbers without overflow of their difference."""
    return np.asarray(low * (1 - range_fraction) + high * range_fraction)


def cast_array(values: Array, dtype: str) -> Array:
    """Convert numbers to another dtype; those beyond its range are clamped to the range."""
    kind = np.dtype(dtype)
    if kind.kind in "iuf":
        limits = np.finfo(kind) if kind.kind == "f" else np.iinfo(kind)
        highest = limits.max
        if values.dtype.kind == "f" and float(highest) > highest:
            highest = int(np.nextafter(float(highest), 0))  # the double beside 2⁶³ − 1 is 2⁶³
        values = np.clip(values, limits.min, highest)
    return np.asarray(values.astype(kind))


def _default_range(spec: Input) -> tuple[float, float]:
    default_ranges = {
        "pose": (-0.6, 0.6),
        "root_rotation": (-0.6, 0.6),
        "root_translation": (-0.5, 0.5),
        "audio": (-1.0, 1.0),
    }
    return default_ranges.get(spec.role, (0.0, 1.0))


def _viewport_at_fraction(range_fraction: float) -> tuple[float, float]:
    return _VIEWPORT_SIZES[round(range_fraction * (len(_VIEWPORT_SIZES) - 1))]


def _projection_at_fraction(range_fraction: float) -> Float[np.ndarray, "4 4"]:
    """Return the projection matrix of a test camera on a spiral around the scene."""
    min_fov, max_fov = _FOV_RANGE
    width, height = _viewport_at_fraction(range_fraction)
    return perspective(
        min_fov + (max_fov - min_fov) * range_fraction,
        width / height,
        _NEAR_PLANE_DISTANCE,
        _FAR_PLANE_DISTANCE,
    )


def _camera(manifest: Manifest, range_fraction: float) -> Float[np.ndarray, "4 4"]:
    """Return the view matrix of a test camera on a spiral around the declared bounds."""
    scene = SceneExtent.from_manifest(manifest)
    side = np.roll(scene.up, 1)
    azimuth = 1.75 * np.pi * range_fraction + 0.3
    elevation = np.deg2rad(-30 + 80 * range_fraction)
    ring = np.cos(azimuth) * side + np.sin(azimuth) * np.cross(scene.up, side)
    direction = np.cos(elevation) * ring + np.sin(elevation) * scene.up
    return look_at(scene.center + ORBIT_RADII * scene.radius * direction, scene.center, scene.up)


@dataclass(frozen=True, slots=True)
class SceneExtent:
    """The bounding box around which test cameras are placed, and the up direction."""

    center: Float[np.ndarray, " 3"]
    half: Float[np.ndarray, " 3"]
    up: Float[np.ndarray, " 3"]

    @classmethod
    def from_manifest(cls, manifest: Manifest) -> "SceneExtent":
        """Return the bounding box in which test cameras are placed, from the manifest's bounds."""
        bounds = getattr(manifest, "bounds", None) or Bounds((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0))
        low, high = np.clip([bounds.min, bounds.max], -_MAX_COORDINATE, _MAX_COORDINATE)
        space = getattr(manifest, "space", None)
        axis = space.up if space else "-y"
        up = np.zeros(3)
        up[_UP_AXES[axis[1]]] = 1.0 if axis[0] == "+" else -1.0
        return cls((low + high) / 2, (high - low) / 2, up)

    @property
    def radius(self) -> float:
        """Half the diagonal of the bounding box, at least 0.001 scene units."""
        return max(float(np.linalg.norm(self.half)), 1e-3)


def _probe_label(manifest: Manifest, inputs: dict[str, Array], index: int) -> str:
    words = []
    if any(i.role in ("view", "camera_position") for i in manifest.inputs):
        words.append(f"camera {index}")
    for i in manifest.inputs:
        if inputs[i.name].size == 1:
            words.append(f"{i.name}={inputs[i.name].item():.3g}")
    return ", ".join(words) or f"sample {index}"
