"""Fields of the manifest, beyond what the schema and the rules' examples show."""

import json
from dataclasses import replace

import numpy as np
import onnx
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gsgen.conformance.fixtures import find
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import MANIFEST_KEY, NEUTRAL_KEY, open_model, write_manifest
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import GeneratorManifest, Input, ReferenceImage
from gsgen.contract.spec.manifest_io import dumps, loads
from gsgen.contract.spec.operator_tables import GRAPH_CAPTURE, operator_table
from gsgen.contract.spec.reader_needs import READER_PROFILES, smallest_profile
from gsgen.contract.spec.targets import load_target
from gsgen.contract.tools.test_vector_files import record_vectors
from gsgen.contract.validator import validate


@given(
    low=st.floats(-1e3, 1e3),
    length=st.floats(1e-2, 1e3),
    frames=st.integers(1, 5000),
    loop=st.booleans(),
    data=st.data(),
)
def test_a_frame_is_shown_from_its_moment_on(low, length, frames, loop, data):
    entry = Input(name="t", role="time", range=(low, low + length), frames=frames, loop=loop)
    frame = data.draw(st.integers(0, frames - 1))
    starts = np.array([entry.time_of_frame(each) for each in range(frames)], np.float32)
    last = int(np.flatnonzero(starts == starts[frame])[-1])  # float32 may not tell frames apart
    assert entry.frame_at(entry.time_of_frame(frame)) == last
    assert entry.frame_at(float(starts[frame])) == last
    before = np.nextafter(starts[frame], np.float32(-np.inf))
    if frame > 0 and starts[frame - 1] < starts[frame]:
        assert entry.frame_at(float(before)) == int(np.flatnonzero(starts <= before)[-1])
    first = int(np.flatnonzero(starts == starts[0])[-1])
    assert entry.frame_at(low + length) == (first if loop else frames - 1)


@pytest.mark.parametrize("frames", [7, 24, 60, 120, 5000])
@pytest.mark.parametrize("ends", [(0.0, 1.0), (0.0, 12.5), (100.0, 101.0), (-0.3, 0.7)])
def test_float32_times_of_frames_show_their_frames(ends, frames):
    entry = Input(name="t", role="time", range=ends, frames=frames)
    times = [float(np.float32(entry.time_of_frame(frame))) for frame in range(frames)]
    assert [entry.frame_at(time) for time in times] == list(range(frames))


@pytest.mark.parametrize("changes", [{"frames": None}, {"range": None}, {"role": "control"}])
def test_only_a_time_with_frames_has_moments(changes):
    entry = replace(Input(name="t", role="time", range=(0.0, 1.0), frames=3), **changes)
    with pytest.raises(ValueError, match="input 't' is not a time input with a range and frames"):
        entry.time_of_frame(0)


def test_an_inputs_name_comes_before_its_role():
    inputs = tuple(Input(name=name, role="control") for name in ("a", "b", "view"))
    manifest = replace(find("still_sh0").draw().manifest, inputs=inputs)
    assert isinstance(manifest, GeneratorManifest)

    def idle(**depends_on):
        changed = replace(manifest, depends_on=depends_on)
        return [entry.name for entry in inputs if not changed.depends(entry)]

    assert idle() == []
    assert idle(control=False) == ["a", "b", "view"]
    assert idle(control=False, b=True) == ["a", "view"]
    assert idle(a=False) == ["a"]
    assert idle(view=False) == ["view"]  # the input of that name, although its role is another


def test_a_denied_dependence_of_one_input_is_found_by_its_name(tmp_path):
    spec = find("two_sliders_one_idle").draw()
    spec.with_manifest(depends_on={"a": False}).write(tmp_path / "a.onnx")
    report = validate(tmp_path / "a.onnx")
    actual = {(finding.rule, str(finding.where)) for finding in report.findings}
    assert ("GB022", "input a") in actual  # a moves the rows
    assert ("GB003", "input b") not in actual  # b is not named, and its role has an effect


def test_from_is_written_as_json_has_it():
    image = ReferenceImage(
        path="a.png",
        sha256="0" * 64,
        inputs="time=0",
        view=((1.0, 0, 0, 0), (0, 1.0, 0, 0), (0, 0, 1.0, 0)),
        focal=(1.0, 1.0),
        center=(0.5, 0.5),
        from_="source",
    )
    manifest = replace(find("still_sh0").draw().manifest, reference_images=(image,))
    document = json.loads(dumps(manifest))
    assert document["reference_images"][0]["from"] == "source"
    assert "from_" not in document["reference_images"][0]
    assert loads(dumps(manifest)) == manifest


def test_a_manifest_under_the_neutral_key_is_read_and_replaced(tmp_path):
    path = find("still_sh0").write(tmp_path)
    model = onnx.load(path)
    model.metadata_props[0].key = NEUTRAL_KEY
    onnx.save(model, path)
    assert validate(path).verdict == "conforms"
    manifest = loads(open_model(path).manifest_text)
    write_manifest(path, replace(manifest, name="other"), path)
    keys = [entry.key for entry in onnx.load(path).metadata_props]
    assert keys == [MANIFEST_KEY]  # one of them would be out of date


def test_every_operator_of_the_portable_profile_is_captured():
    profile = READER_PROFILES["portable-1"]
    for name in load_target("webgpu").operators:
        captured = {
            operator.partition("/")[0]
            for (operator, _), steps in operator_table(name).outcomes.items()
            if GRAPH_CAPTURE in steps.values()
        }
        assert profile.operators - captured == {"Constant"}, name


def test_a_profile_is_chosen_by_operators_and_their_set():
    assert smallest_profile({"Add", "Mul"}, 18) == "portable-1"
    assert smallest_profile({"Add", "Loop"}, 18) is None
    assert smallest_profile({"Add"}, 23) is None


def test_vectors_bring_their_inputs_as_files_with_digests(tmp_path):
    source = find("drift").write(tmp_path)
    recorded = record_vectors(source, tmp_path / "vectors", tmp_path / "copy.onnx")
    files = [file for vector in recorded.vectors for file in vector.files]
    assert [file.input for file in files] == ["time"] * 3
    assert files[1].path == "vectors/test_data_set_1/input_0.pb"
    subject = inspect_model(open_model(recorded.model), load_target("core"), Limits())
    assert subject.manifest.test_vectors == recorded.vectors
    tensor = onnx.load_tensor(str(tmp_path / files[1].path))
    label = f"time={onnx.numpy_helper.to_array(tensor).item():.3g}"
    assert recorded.vectors[1].inputs == label
    assert validate(recorded.model).verdict == "conforms"
    (tmp_path / files[0].path).write_bytes(b"")
    assert [finding.rule for finding in validate(recorded.model).findings] == ["GM033"]


def test_vectors_elsewhere_are_not_named_as_files(tmp_path):
    source = find("drift").write(tmp_path)
    (tmp_path / "a").mkdir()
    recorded = record_vectors(source, tmp_path / "b", tmp_path / "a" / "copy.onnx")
    assert all(not vector.files for vector in recorded.vectors)
    assert np.all([vector.expected_sha256 for vector in recorded.vectors])
