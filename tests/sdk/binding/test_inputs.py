"""What may be fed to a model, what is refused in which words, and what is fed by default."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from onnx import parser

from gsgen.conformance.fixtures.builders.moving import input_driven_model
from gsgen.contract.errors import ConfigInvalid, GsgenError, ManifestInvalid, ModelUnreadable
from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.spec.geometry import perspective
from gsgen.contract.spec.input_defaults import default_tensor
from gsgen.contract.spec.manifest import Input
from gsgen.runtime.scene.camera import Camera
from gsgen.sdk.binding import FrameSession, InputInvalid, RunFailed, SizeUnknown
from gsgen.sdk.binding.bound.input_binding import InputBinding
from gsgen.sdk.binding.camera_inputs import camera_values, pinhole_projection
from support.models.small_models import HEAD, good_rows, moving, save

DECLARED_INPUTS = (
    Input(name="a", role="control", shape=(1,), range=(0, 1), default=0.25),
    Input(name="b", role="control", shape=(1,), range=(0, 1), default=0.5),
    Input(name="index", role="frame_index", shape=(1,), range=(0, 9)),
    Input(name="pose", role="pose", shape=(1, 3)),
)


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    path = tmp_path_factory.mktemp("inputs") / "many.onnx"
    shift = (
        "whole = Cast <to = 1> (index) sum = Sum (a, b, whole) row = Squeeze (pose, zero) "
        "shift = Add (row, sum)"
    )
    text = "float[1] a, float[1] b, int32[1] index, float[1,3] pose"
    input_driven_model(text, DECLARED_INPUTS, shift).with_weights(zero=np.zeros(1, np.int64)).write(
        path
    )
    with FrameSession(path, provider="cpu") as frame_session:
        yield frame_session


@pytest.mark.parametrize(
    ("values", "expected_message"),
    [
        ({"pos": 0}, "unknown input 'pos'"),
        ({"pose": np.zeros(3)}, "input pose: the value has shape [3], expected shape [1, 3]"),
        ({"pose": 1}, "input pose: the value has shape [], expected shape [1, 3]"),
        ({"pose": [[1, 2], [3]]}, "input pose: the value cannot be converted to an array: "),
        ({"pose": [["x", "y", "z"]]}, "input pose: the value is <U1, expected float32"),
        ({"a": 1.5}, "input a (role control): the value is 1.5, expected 0 … 1"),
        ({"a": np.nan}, "input a (role control): the value is nan, expected 0 … 1"),
        ({"a": None}, "input a (role control): the value is object, expected float32"),
        ({"a": 1j}, "input a (role control): the value is complex128, expected float32"),
        ({"index": 0.5}, "input index (role frame_index): the value is float64, expected int32"),
        ({"index": 10}, "input index (role frame_index): the value is 10, expected 0 … 9"),
        (
            {"index": 1 << 40},
            "the value is 1099511627776 … 1099511627776, which int32 cannot represent",
        ),
        ({"control": 0.5}, "2 inputs have role 'control', expected one of a, b"),
    ],
)
def test_mismatched_values_are_refused(values, expected_message, session):
    before = session.run(copy=True)["gaussians"]
    with pytest.raises(GsgenError) as raised:
        session.run({"b": 0.9} | values)
    assert expected_message in str(raised.value)
    np.testing.assert_array_equal(session.run()["gaussians"], before)  # b is not updated either


def test_a_role_stands_for_the_one_input_that_has_it(session):
    first = session.run({"frame_index": 2, "a": 0, "b": 0}, copy=True)["gaussians"]
    two = session.run({"index": np.int64(2), "pose": np.zeros((1, 3))}, copy=True)["gaussians"]
    np.testing.assert_array_equal(first, two)


def test_tensors_are_written_as_they_are(session):
    session.write({"a": np.array([7.0])})  # beyond the range: nothing is asked
    with pytest.raises(GsgenError, match="unknown input 'frame_index'"):
        session.write({"frame_index": np.array([1])})
    with pytest.raises(InputInvalid, match="has shape"):
        session.write({"pose": np.zeros(3)})
    session.update({"a": 0})


def test_a_camera_needs_a_manifest_and_two_matrices(session, tmp_path):
    session.run(camera=(np.eye(4), np.eye(4)))  # a model that wants no camera takes any
    for wrong in (np.eye(3), 7, (np.eye(3), np.eye(4))):
        with pytest.raises(InputInvalid, match="camera"):
            session.run(camera=wrong)
    path = save(tmp_path / "a.onnx", moving(good_rows(2)))
    with FrameSession(path, provider="cpu") as bare:
        with pytest.raises(InputInvalid, match="no manifest declares the camera inputs") as raised:
            bare.run(camera=(np.eye(4), np.eye(4)))
        assert "gsgen inspect --emit-manifest" in raised.value.hint


def test_a_camera_tells_its_centre_and_viewport():
    class Matrices:
        view = np.array([[0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 1, 4], [0, 0, 0, 1.0]])
        projection = np.eye(4)
        width, height = 640, 480

    values = camera_values(Matrices())
    centre = values["camera_position"]
    np.testing.assert_allclose(Matrices.view @ [*centre, 1], [0, 0, 0, 1], atol=1e-12)
    assert values["viewport"].tolist() == [640, 480]
    assert "viewport" not in camera_values((Matrices.view, Matrices.projection))


@given(*[st.floats(0.1, 0.9)] * 2, *[st.floats(-2, 2)] * 2, st.floats(0.5, 50))
def test_intrinsics_project_to_the_pixels_that_they_say(cx, cy, x, y, z):
    camera = Camera(
        np.eye(4), fx=700, fy=650, cx=640 * cx, cy=480 * cy, width=640, height=480, near=0.1
    )
    values = camera_values(camera)
    clip = values["projection"] @ [x, y, z, 1]
    u, v = (clip[0] / clip[3] + 1) / 2 * 640, (1 - clip[1] / clip[3]) / 2 * 480
    assert u == pytest.approx(700 * x / z + camera.cx, abs=1e-6)
    assert v == pytest.approx(650 * y / z + camera.cy, abs=1e-6)
    assert 0 <= clip[2] / clip[3] <= 1
    assert values["viewport"].tolist() == [640, 480]


def test_intrinsics_in_the_middle_give_the_projection_of_the_conventions():
    camera = Camera(np.eye(4), fx=500, fy=500, cx=320, cy=240, width=640, height=480, near=0.01)
    expected = perspective(2 * np.arctan(320 / 500), 640 / 480, 0.01, 1000)
    np.testing.assert_allclose(pinhole_projection(camera), expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("entry", "shape", "expected"),
    [
        (Input(name="x", role="view"), (4, 4), np.eye(4)),
        (Input(name="x", role="control", range=(2, 3)), (2,), [2, 2]),
        (Input(name="x", role="time"), (1,), [0]),
        (Input(name="x", role="time", default=0.5), (1,), [0.5]),
        (Input(name="x", role="pose", default="zeros"), (2, 3), np.zeros((2, 3))),
        (Input(name="x", role="pose", default="identity"), (4, 4), [[1, 0, 0, 0]] * 4),
        (Input(name="x", role="root_rotation", default="identity"), (3,), [0, 0, 0]),
        (Input(name="x", role="root_rotation", default="identity"), (3, 3), np.eye(3)),
        (Input(name="x", role="pose", default=(1, 2, 3, 4, 5, 6)), (2, 3), [[1, 2, 3], [4, 5, 6]]),
    ],
)
def test_defaults_are_those_of_the_specification(entry, shape, expected):
    np.testing.assert_array_equal(default_tensor(entry, shape), expected)


def test_a_default_that_does_not_fill_its_input_is_refused():
    entry = Input(name="x", role="pose", default=(1, 2))
    binding = InputBinding(
        name="x", dtype=np.dtype("float32"), shape=(2, 3), declared=entry, order="column"
    )
    with pytest.raises(InputInvalid, match="default has 2 numbers, expected 6"):
        binding.default()


@given(st.lists(st.floats(-5, 5), min_size=16, max_size=16), st.sampled_from(["row", "column"]))
def test_matrices_are_transposed_for_column_order_alone(numbers, order):
    matrix = np.array(numbers).reshape(4, 4)
    entry = Input(name="m", role="view")
    binding = InputBinding(
        name="m", dtype=np.dtype("float32"), shape=(4, 4), declared=entry, order=order
    )
    tensor = binding.tensor(matrix)
    expected = matrix.astype(np.float32)
    np.testing.assert_array_equal(tensor, expected.T if order == "column" else expected)


# ---- Sizes -----------------------------------------------------------------------------------


def symbolic(tmp_path, text="float[J,3] pose", **metadata):
    body = f"g ({text}, float[1] t) => (float[M,3] y, float[K] z) {{ y = Mul (pose, t) s = Constant <value_ints = [-1]> () w = Mul (y, t) z = Reshape (w, s) }}"
    proto = parser.parse_model(HEAD + body)
    for key, value in metadata.items():
        proto.metadata_props.add(key=key, value=value)
    return save(tmp_path / "a.onnx", proto)


@pytest.mark.parametrize("provider", ["cpu", "webgpu"])
@pytest.mark.parametrize(
    ("text", "name"), [("float[J,3] pose", "J"), ("float[?,3] pose", "pose[0]")]
)
def test_open_dimensions_take_the_size_that_is_given(provider, text, name, tmp_path):
    path = symbolic(tmp_path, text)
    with FrameSession(path, provider=provider, sizes={name: 2}, capture=False) as session:
        assert session.inputs["pose"].shape == (2, 3)
        frame = session.run({"pose": np.arange(6.0).reshape(2, 3), "t": 3})
        np.testing.assert_array_equal(frame["y"], [[0, 3, 6], [9, 12, 15]])
        assert frame["z"].shape == (6,)


def test_open_dimensions_need_a_size(tmp_path):
    path = symbolic(tmp_path)
    with pytest.raises(SizeUnknown) as raised:
        FrameSession(path, provider="cpu")
    assert str(raised.value) == (
        "tensor pose: axis 0 is symbolic (J), expected a size\n  Give its size: `--size J=24`, or in Python sizes={'J': 24}."
    )
    with pytest.raises(GsgenError, match="unknown open dimension 'j'"):
        FrameSession(path, provider="cpu", sizes={"j": 2})
    with pytest.raises(ConfigInvalid, match="size J: the size is 0, expected at least 1"):
        FrameSession(path, provider="cpu", sizes={"J": 0})


def test_unused_size_is_refused(models):
    with pytest.raises(ConfigInvalid, match="the model has no open dimension"):
        FrameSession(models["drift-float32"], provider="cpu", sizes={"N": 2})


# ---- Files -----------------------------------------------------------------------------------


def test_non_model_file_is_refused(tmp_path):
    with pytest.raises(ModelUnreadable):
        FrameSession(tmp_path / "absent.onnx")
    with pytest.raises(ManifestInvalid):
        FrameSession(symbolic(tmp_path, **{MANIFEST_KEY: "{"}), provider="cpu")


@pytest.mark.parametrize("provider", ["cpu", "webgpu"])
def test_outputs_that_nothing_can_hold_are_refused(provider, tmp_path):
    text = "g (float[1] t) => (float[8,1099511627776] y) { s = Constant <value_ints = [8, 1099511627776]> () y = Expand (t, s) }"
    path = save(tmp_path / "a.onnx", parser.parse_model(HEAD + text))
    with pytest.raises(
        RunFailed, match=r"output y: the output of shape \[8, 1.*\] takes 35184.4 GB, more than"
    ):
        FrameSession(path, provider=provider, capture=False)


def test_onnx_runtime_load_error_is_quoted(tmp_path):
    text = "g (float[1] t) => (float[1] y) { y = Nonsense (t) }"
    path = save(tmp_path / "a.onnx", parser.parse_model(HEAD + text))
    with pytest.raises(RunFailed, match="Nonsense") as raised:
        FrameSession(path, provider="cpu")
    assert "ONNXRuntimeError" not in str(raised.value)
