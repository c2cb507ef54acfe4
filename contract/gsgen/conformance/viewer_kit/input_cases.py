"""Viewer tests of inputs: every input role, matrix memory orders, cameras, replayed frames."""

__all__ = ["INPUT_CASES"]

import numpy as np

from gsgen.conformance.fixtures.builders.clouds import still
from gsgen.conformance.fixtures.builders.fixture import Fixture
from gsgen.conformance.fixtures.builders.moving import (
    camera_dependent_model,
    drifting_model,
    input_driven_model,
)
from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.conformance.fixtures.valid import moving, scene_inputs
from gsgen.conformance.viewer_kit.case import (
    COMMON_SH_FAULTS,
    KitFrame,
    ViewerKitCase,
    kit_camera,
    orbit_frame,
)
from gsgen.contract.spec.manifest import Input

_OPPOSITE_VIEW_FRAMES = (
    KitFrame(camera=kit_camera()),
    KitFrame(camera=kit_camera((-1.6, -0.4, 2.2))),
)
_SHIFTED_FRAMES = tuple(
    KitFrame(camera=kit_camera(eye, cx=24.0, cy=30.0))
    for eye in ((1.2, -1.0, -2.6), (-1.6, -0.4, 2.2))
)
_MOVING_MODEL_FAULTS = (*COMMON_SH_FAULTS, "stale-outputs")


def _projection_model() -> ModelSpec:
    """Return a model whose Gaussians move with the product of view and projection matrices."""
    entries = (
        Input(name="lens", role="projection", default="identity"),
        Input(name="eye", role="view", default="identity"),
    )
    shift = (
        "both = MatMul (eye, lens) column = MatMul (both, weights) "
        "top = Slice (column, first, last) shift = Transpose (top)"
    )
    model = input_driven_model("float[4,4] lens, float[4,4] eye", entries, shift)
    return model.with_weights(
        weights=np.array([[0.1], [0.2], [0.3], [0.05]], np.float32),
        first=np.array([0], np.int64),
        last=np.array([3], np.int64),
    )


def _viewport_model() -> ModelSpec:
    entry = Input(name="pixels", role="viewport", default=(1280.0, 720.0))
    shift = "parts = Mul (pixels, small) all = ReduceSum <keepdims = 1> (parts) shift = Tanh (all)"
    small_variances = np.array(
        [6e-3, 1e-3], np.float32
    )  # unequal: the order of the two numbers is seen
    return input_driven_model("float[2] pixels", entry, shift).with_weights(small=small_variances)


def _eye_position_model() -> ModelSpec:
    entry = Input(name="where", role="camera_position", default="zeros")
    shift = "bent = Mul (where, small) shift = Tanh (bent)"
    return input_driven_model("float[3] where", entry, shift).with_weights(
        small=np.array([0.3], np.float32)
    )


def _coefficients() -> ModelSpec:
    entries = (
        Input(name="betas", role="shape", shape=(10,), range=(-1.0, 1.0), default="zeros"),
        Input(name="face", role="expression", shape=(5,), range=(-1.0, 1.0), default="zeros"),
    )
    basis = np.random.default_rng(4).uniform(-0.3, 0.3, (15, 3)).astype(np.float32)
    shift = "joined = Concat <axis = 0> (betas, face) shift = MatMul (joined, basis)"
    return input_driven_model("float[10] betas, float[5] face", entries, shift).with_weights(
        basis=basis
    )


def _moving_model_case(
    name: str,
    tests: str,
    faults: tuple[str, ...],
    fixture: Fixture,
    *frames: KitFrame,
    slight: tuple[str, ...] = (),
) -> ViewerKitCase:
    return ViewerKitCase(
        name=name,
        tests=tests,
        faults=(*_MOVING_MODEL_FAULTS, *faults),
        spec=fixture.draw,
        frames=frames,
        slight=slight,
    )


def _random_array(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.5, 0.5, shape).round(3)


def _pictures(seed: int) -> np.ndarray:
    """Return two random pictures."""
    return np.random.default_rng(seed).random((2, 3, 4, 6)).round(3)


def _picture_views(seed: int) -> np.ndarray:
    """Return the view matrices of two pictures, as in mathematics."""
    rotations = np.linalg.qr(np.random.default_rng(seed).normal(size=(2, 3, 3)))[0]
    views = np.tile(np.eye(4), (2, 1, 1))
    views[:, :3, :3] = rotations * np.linalg.det(rotations)[:, None, None]
    views[:, :3, 3] = _random_array(seed, 2, 3)
    return views.round(4)


def _lenses(focal: float) -> np.ndarray:
    """Return the pinhole matrices of two pictures."""
    matrix = np.array([[focal, 0.0, 3.0], [0.0, focal, 2.0], [0.0, 0.0, 1.0]])
    return np.stack([matrix, matrix])


INPUT_CASES: tuple[ViewerKitCase, ...] = (
    ViewerKitCase(
        name="view-column",
        tests="A view matrix that the tensor holds transposed, as the manifest declares.",
        faults=(*_MOVING_MODEL_FAULTS, "matrix-order", "role-view", "order"),
        spec=lambda: camera_dependent_model(20),
        frames=_OPPOSITE_VIEW_FRAMES,
    ),
    ViewerKitCase(
        name="view-row",
        tests="A view matrix that the tensor holds as it is, as the manifest declares.",
        faults=(
            *_MOVING_MODEL_FAULTS,
            "matrix-order",
            "matrix-order-ignored",
            "role-view",
            "order",
        ),
        spec=lambda: camera_dependent_model(20, order="row"),
        frames=_OPPOSITE_VIEW_FRAMES,
    ),
    ViewerKitCase(
        name="projection",
        tests="A projection with the principal point beside the middle, and a view matrix.",
        faults=(
            *(*_MOVING_MODEL_FAULTS, "matrix-order", "role-projection", "role-view"),
            *("intrinsics", "projection-centre"),
        ),
        spec=_projection_model,
        frames=_SHIFTED_FRAMES,
    ),
    ViewerKitCase(
        name="camera-position",
        tests="The camera centre as an input.",
        faults=(*_MOVING_MODEL_FAULTS, "role-camera_position"),
        spec=_eye_position_model,
        frames=_OPPOSITE_VIEW_FRAMES,
        slight=("dilation",),
    ),
    ViewerKitCase(
        name="viewport",
        tests="The size of the picture as an input.",
        faults=(*COMMON_SH_FAULTS, "role-viewport", "viewport-order"),
        spec=_viewport_model,
        frames=(orbit_frame(),),
        slight=("dilation",),
    ),
    ViewerKitCase(
        name="camera-lens",
        tests="A principal point beside the middle, and pixels that are not square.",
        faults=(*COMMON_SH_FAULTS, "intrinsics", "order"),
        spec=lambda: still(40),
        frames=(KitFrame(camera=kit_camera(fx=70.0, fy=48.0, cx=24.0, cy=30.0)),),
    ),
    ViewerKitCase(
        name="among-gaussians",
        tests="A camera among the Gaussians, of which some lie behind it.",
        faults=(*COMMON_SH_FAULTS, "behind-camera", "order"),
        spec=lambda: still(60),
        frames=(KitFrame(camera=kit_camera((0.1, 0.05, -0.3))),),
        slight=("dilation",),
    ),
    ViewerKitCase(
        name="time-in-seconds",
        tests="Time from 2 to 10, forth and back.",
        faults=(*_MOVING_MODEL_FAULTS, "time-range", "role-time", "order"),
        spec=lambda: drifting_model(12, span=(2.0, 10.0)),
        frames=tuple(orbit_frame(time=[time]) for time in (2.0, 10.0, 5.0, 2.0)),
    ),
    _moving_model_case(
        "frame-index",
        "A frame number in int32.",
        ("role-frame_index",),
        moving.frame_table,
        *(orbit_frame(frame=[number]) for number in (1, 6, 3)),
    ),
    _moving_model_case(
        "pose",
        "Joint rotations of an avatar, and its translation.",
        ("role-pose", "role-root_translation"),
        moving.avatar,
        orbit_frame(pose=_random_array(1, 4, 3), trans=_random_array(2, 3)),
        orbit_frame(pose=_random_array(3, 4, 3), trans=_random_array(4, 3)),
    ),
    _moving_model_case(
        "root-rotation",
        "The rotation of an avatar's root as a matrix, stored row by row.",
        ("role-root_rotation",),
        moving.turned_back,
        orbit_frame(turn=[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        orbit_frame(turn=[[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
        slight=("dilation",),
    ),
    ViewerKitCase(
        name="coefficients",
        tests="Coefficients of a body's shape and of its expression.",
        faults=(*_MOVING_MODEL_FAULTS, "role-shape", "role-expression"),
        spec=_coefficients,
        frames=(
            orbit_frame(betas=_random_array(5, 10), face=_random_array(6, 5)),
            orbit_frame(betas=_random_array(7, 10), face=_random_array(8, 5)),
        ),
        slight=("dilation",),
    ),
    _moving_model_case(
        "appearance-id",
        "An identity number in int32 that chooses the colours.",
        ("role-appearance_id",),
        moving.appearance_id,
        *(orbit_frame(look=[number]) for number in (3, 1)),
        slight=("dilation",),
    ),
    _moving_model_case(
        "control",
        "A slider with a label of its own.",
        ("role-control",),
        moving.slider,
        *(orbit_frame(amount=[amount]) for amount in (2.0, 0.0)),
    ),
    ViewerKitCase(
        name="pictures",
        tests="Two pictures, their cameras and lenses, which other pictures replace.",
        faults=(
            *(*_MOVING_MODEL_FAULTS, "matrix-order"),
            *("role-image", "role-image_view", "role-image_intrinsics"),
        ),
        spec=scene_inputs.posed_picture_model,
        frames=(
            orbit_frame(image=_pictures(9), poses=_picture_views(10), lenses=_lenses(9.0)),
            orbit_frame(image=_pictures(11), poses=_picture_views(12), lenses=_lenses(4.0)),
        ),
        slight=("dilation",),
    ),
    ViewerKitCase(
        name="default",
        tests="A slider without a value, which has the default of the manifest.",
        faults=(*COMMON_SH_FAULTS, "default"),
        spec=moving.slider.draw,
        frames=(orbit_frame(),),
    ),
)
"""The cases of inputs."""
