"""The scene pass: which operators it is, that it runs when its inputs change, and no others do."""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.conformance.fixtures.builders.sketch import ModelSpec
from gsgen.conformance.fixtures.valid.scene_inputs import (
    CODE,
    conditioned_and_moving_model,
    picture_model,
)
from gsgen.contract.model.files_beside import FileRefused
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest import GeneratorManifest, Input
from gsgen.contract.spec.manifest_io import loads
from gsgen.sdk.binding import FrameSession
from gsgen.sdk.binding.bound.scene_pass import ScenePassSession, split_model

OPERATORS = ("Add", "Mul", "Sub", "Max")


def write_model(folder: Path, spec: ModelSpec) -> Path:
    path = folder / "model.onnx"
    spec.write(path)
    return path


def manifest_of(path: Path) -> GeneratorManifest:
    text = open_model(path).manifest_text
    assert text is not None
    manifest = loads(text)
    assert isinstance(manifest, GeneratorManifest)
    return manifest


def scene_pass_of(session: FrameSession) -> ScenePassSession:
    bound = session._bound
    assert isinstance(bound, ScenePassSession)
    return bound


def random_values(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {
        "code": rng.uniform(-1, 1, (2, 3)).astype(np.float32),
        "time": rng.random(1).astype(np.float32),
    }


@pytest.mark.parametrize("confined", [False, True])
def test_frames_of_two_passes_equal_those_of_the_whole_graph(tmp_path: Path, *, confined: bool):
    path = write_model(tmp_path, conditioned_and_moving_model())
    whole = onnxruntime.InferenceSession(path)
    names = [output.name for output in whole.get_outputs()]
    with FrameSession(path, provider="cpu", confined=confined) as session:
        for seed in (0, 1, 1, 0):
            values = random_values(seed)
            frame = session.run(values)
            for name, expected in zip(names, whole.run(names, values), strict=True):
                np.testing.assert_array_equal(frame[name], expected)


def test_the_scene_pass_runs_when_its_inputs_change_by_content(tmp_path: Path):
    path = write_model(tmp_path, conditioned_and_moving_model())
    with FrameSession(path, provider="cpu") as session:
        values = random_values(0)
        session.run(values)
        runs = scene_pass_of(session).scene_runs
        for time in (0.1, 0.2, 0.3):
            session.run({"time": time, "code": values["code"].copy()})
        assert scene_pass_of(session).scene_runs == runs
        session.run({"code": values["code"] + np.float32(1e-3)})
        assert scene_pass_of(session).scene_runs == runs + 1


def test_a_model_with_one_pass_is_not_split(tmp_path: Path):
    path = write_model(tmp_path, picture_model())
    assert split_model(onnx.load(path), manifest_of(path)) is None
    with FrameSession(path, provider="cpu") as session:
        assert not isinstance(session._bound, ScenePassSession)


def test_weights_in_other_files_leave_the_model_whole(tmp_path: Path):
    path = write_model(tmp_path, conditioned_and_moving_model())
    manifest = manifest_of(path)
    model = onnx.load(path)
    assert split_model(model, manifest) is not None
    onnx.save(model, path, save_as_external_data=True, location="weights.bin", size_threshold=0)
    assert split_model(onnx.load(path, load_external_data=False), manifest) is None
    with FrameSession(path, provider="cpu") as session:
        assert not isinstance(session._bound, ScenePassSession)


def test_a_constant_in_another_file_is_refused_by_the_gate(tmp_path: Path):
    """A pass is opened from memory, past the check of the files that a model names."""
    (tmp_path / "weights.bin").write_bytes(bytes(12))
    (tmp_path / "models").mkdir()
    path = write_model(tmp_path / "models", conditioned_and_moving_model())
    model = onnx.load(path)
    node = onnx.NodeProto(op_type="Constant", output=["stored"])
    attribute = node.attribute.add(name="value", type=onnx.AttributeProto.TENSOR)
    attribute.t.CopyFrom(
        onnx.TensorProto(data_type=onnx.TensorProto.FLOAT, dims=[3], data_location="EXTERNAL")
    )
    attribute.t.external_data.add(key="location", value="../weights.bin")
    model.graph.node.insert(0, node)
    path.write_bytes(model.SerializeToString())
    with pytest.raises(FileRefused, match=r"weights\.bin"):
        FrameSession(path, provider="cpu")


@st.composite
def graphs(draw: st.DrawFn) -> str:
    """Draw ONNX text of a graph whose nodes join earlier results, inputs and a weight."""
    names, nodes = ["code", "time", "weight"], []
    for number in range(draw(st.integers(1, 8))):
        first, second = (draw(st.sampled_from(names)) for _ in range(2))
        name = f"n{number}"
        nodes.append(f"{name} = {draw(st.sampled_from(OPERATORS))} ({first}, {second})")
        names.append(name)
    outputs = draw(st.lists(st.sampled_from(names[3:]), min_size=1, max_size=3, unique=True))
    declared = ", ".join(f"float[3] {name}" for name in outputs)
    return (
        '<ir_version: 8, opset_import: ["" : 18]> passes (float[3] code, float[3] time) => '
        f"({declared}) <float[3] weight = {{0.5, -2.0, 3.0}}> {{ {' '.join(nodes)} }}"
    )


@settings(deadline=None, max_examples=60)
@given(graphs())
def test_any_graph_in_two_passes_computes_the_same(text: str):
    model = onnx.parser.parse_model(text)
    entries = (
        Input(name="code", role="condition", range=(-1.0, 1.0), pass_="scene"),
        Input(name="time", role="control", range=(-1.0, 1.0)),
    )
    manifest = GeneratorManifest(name="any", inputs=entries, outputs=manifest_outputs())
    split = split_model(model, manifest)
    rng = np.random.default_rng(0)
    values = {name: rng.uniform(-1, 1, 3).astype(np.float32) for name in ("code", "time")}
    whole = session_of(model)
    names = [output.name for output in whole.get_outputs()]
    expected = dict(zip(names, whole.run(names, values), strict=True))
    if split is None:
        return
    assert not {name for node in split.scene for name in node.input} & {"time"}
    scene = session_of(split.scene_model())
    results = dict(
        zip(
            [output.name for output in scene.get_outputs()],
            scene.run(None, {"code": values["code"]}),
            strict=True,
        )
    )
    buffers = {name: SizedArray(results[name]) for name in split.passed}
    frame = session_of(split.frame_model(buffers))
    feeds = {
        entry.name: values[entry.name] if entry.name in values else results[entry.name]
        for entry in frame.get_inputs()
    }
    frame_names = [output.name for output in frame.get_outputs()]
    results |= dict(zip(frame_names, frame.run(frame_names, feeds), strict=True))
    for name in names:
        np.testing.assert_array_equal(results[name], expected[name])


def session_of(model: onnx.ModelProto) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # random graphs have weights that nothing reads
    return onnxruntime.InferenceSession(model.SerializeToString(), options)


class SizedArray:
    """The shape and dtype of an array, as a buffer has them."""

    def __init__(self, array: np.ndarray) -> None:
        self.shape, self.dtype = array.shape, array.dtype


def manifest_outputs():
    spec = conditioned_and_moving_model()
    assert isinstance(spec.manifest, GeneratorManifest)
    return spec.manifest.outputs


def test_a_scene_input_that_the_frame_reads_as_well_is_an_input_of_both(tmp_path: Path):
    shift = (
        "numbers = Flatten <axis = 0> (code) direction = MatMul (numbers, basis) "
        "again = Flatten <axis = 0> (code) sum = MatMul (again, basis) late = Mul (sum, time) "
        "shift = Add (direction, late)"
    )
    path = write_model(tmp_path, conditioned_and_moving_model(shift, entry=CODE))
    whole = onnxruntime.InferenceSession(path)
    values = random_values(3)
    with FrameSession(path, provider="cpu") as session:
        frame = session.run(values)
        (expected,) = whole.run(["gaussians"], values)
        np.testing.assert_array_equal(frame["gaussians"], expected)
