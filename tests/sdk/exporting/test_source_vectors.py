"""Rows of the eager module at export: level behaviour sees what later changes the numbers."""

import json
from types import SimpleNamespace

import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.model_file import MANIFEST_KEY, open_model
from gsgen.contract.spec.fields.json_schema import to_json
from gsgen.contract.spec.manifest import Tolerances, WeightedSum
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.tools.test_vector_files import record_vectors
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk import Cells, GaussianGenerator, Gaussians, export, inputs
from gsgen.sdk.exporting.source_vectors import RowRecorder
from gsgen.sdk.float16.convert_model import write_float16

COUNT = 24


class Ball(GaussianGenerator):
    """Gaussians on a sphere that moves with time, in cells of three."""

    inputs = (inputs.time(range=(0, 1)), inputs.control("width", range=(0.5, 1.0), default=1.0))
    family = "4d"
    weighted_sum = WeightedSum(background=0.1)

    def __init__(self) -> None:
        super().__init__()
        points = torch.randn(COUNT, 3, generator=torch.Generator().manual_seed(0))
        self.register_buffer("points", points / points.norm(dim=1, keepdim=True))
        self.register_buffer("tints", 0.5 + 0.4 * self.points)

    def forward(self, time: torch.Tensor, width: torch.Tensor) -> Gaussians:
        ones = torch.ones_like(self.points)
        position = self.points + 0.2 * time
        upright = torch.tensor([1.0, 0, 0, 0]) * ones[:, :1]
        middle = position.reshape(-1, 3, 3).mean(dim=1)
        cells = Cells(middle, 0.9 * ones[::3, 0], scale=ones[::3], rotation=upright[::3])
        return Gaussians(
            position=position,
            opacity=0.9 * ones[:, 0],
            scale=0.12 * width * ones,
            rotation=upright,
            rgb=self.tints,
            cells=cells,
        )


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    return export(Ball(), tmp_path_factory.mktemp("vectors") / "ball.onnx")


def edited(path, change, name="edited.onnx"):
    """Write a copy of a model in which ``change`` may replace each weight's array."""
    proto = onnx.load(path)
    changes = 0
    for weight in proto.graph.initializer:
        array = numpy_helper.to_array(weight)
        result = change(array)
        if result is not None:
            weight.CopyFrom(numpy_helper.from_array(result, weight.name))
            changes += 1
    assert changes, "no weight was changed"
    copy = path.with_name(name)
    onnx.save(proto, copy)
    return copy


def rewritten(path, change, name="rewritten.onnx"):
    """Write a copy of a model with another manifest."""
    proto = onnx.load(path)
    (entry,) = [entry for entry in proto.metadata_props if entry.key == MANIFEST_KEY]
    document = json.loads(entry.value)
    change(document)
    entry.value = json.dumps(document)
    copy = path.with_name(name)
    onnx.save(proto, copy)
    return copy


def messages(path, **settings):
    """Return what level behaviour finds, except that mirrored points lie outside the bounds."""
    report = validate(path, Settings(**settings))
    assert report.outcome("GM037").status in ("pass", "fail")
    return [finding.message for finding in report.findings if finding.rule != "GV021"]


def test_an_export_records_rows_of_the_module_and_reproduces_them(exported):
    vectors = loads(open_model(exported.path).manifest_text).test_vectors
    assert vectors == exported.manifest.test_vectors
    assert len(vectors) == 2
    assert messages(exported.path) == []
    ball = Ball()
    for vector in vectors:
        values = {entry.input: torch.tensor(entry.values) for entry in vector.values}
        eager = ball(values["time"], values["width"])
        parts = {part.output: part for part in vector.outputs}
        color = parts["color_rgb"]
        expected = eager.rgb[list(color.rows)].numpy()
        assert np.array_equal(np.array(color.values, np.float32), expected)
        assert parts["num_points"].values == ((float(COUNT),),)
        cells = parts["cells"]
        middle = eager.cells.position[list(cells.rows)].numpy()
        assert np.allclose(np.array(cells.values)[:, :3], middle, atol=1e-6)


def is_tints(array):
    return array.shape == (COUNT, 3) and bool(array.min() >= 0) and bool(array.std() > 0.1)


def swap_channels(array):
    return array[:, ::-1].copy() if is_tints(array) else None


def mirror(array):
    is_points = array.shape == (COUNT, 3) and array.min() < 0
    return (array * np.float32([-1, 1, 1])) if is_points else None


def round_colors(array):
    return np.round(array, 1) if is_tints(array) else None


@pytest.mark.parametrize(
    ("change", "field"),
    [(swap_channels, "appearance"), (mirror, "position"), (round_colors, "appearance")],
)
def test_plausible_but_changed_outputs_are_detected(exported, change, field):
    reported = messages(edited(exported.path, change))
    assert len(reported) >= 2
    assert all(message.startswith(f"{field} of ") for message in reported)
    assert all("from the source's" in message for message in reported)


def test_other_probes_and_another_seed_do_not_matter(exported):
    """The vectors hold their inputs, so wider bounds move no camera of theirs."""

    def widen(document):
        document["bounds"] = {"min": [-9, -9, -9], "max": [9, 9, 9]}

    assert messages(rewritten(exported.path, widen), seed=5) == []


def test_a_vectors_own_tolerances_and_the_users_count(exported):
    slightly_changed = edited(
        exported.path, lambda a: a + np.float32(0.01) if is_tints(a) else None
    )
    assert len(messages(slightly_changed)) == 2
    loose_tolerances = to_json(Tolerances(appearance=0.05))

    def loosen(document):
        for vector in document["test_vectors"]:
            vector["tolerances"] = loose_tolerances

    path = rewritten(slightly_changed, loosen)
    assert messages(path) == []
    assert len(messages(path, tolerances={"appearance": 0.001})) == 2


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("rows", [0, 99], "row 99 of 'gaussians'; expected less than 24"),
        ("values", [[0.0] * 9] * 2, "9 values in a row of 'gaussians'; expected 10"),
        ("values", [[0.0] * 10], "1 lists of values; expected one for each of 2 rows"),
        ("output", "rows", "no output 'rows'; expected one of 'gaussians'"),
        ("rows", [3, 4], "rows of 'color_rgb'; expected the same rows as of 'gaussians'"),
    ],
)
def test_records_that_cannot_be_compared_are_named(exported, field, value, message):
    def damage(document):
        vector = document["test_vectors"][0]
        document["test_vectors"] = [vector]
        for part in vector["outputs"]:
            part["rows"], part["values"] = part["rows"][:2], part["values"][:2]
        part = next(part for part in vector["outputs"] if part["output"] == "gaussians")
        part[field] = value

    (reported,) = messages(rewritten(exported.path, damage))
    assert message in reported


def test_another_count_and_too_many_vectors_are_named(exported):
    def other_count(document):
        for part in document["test_vectors"][0]["outputs"]:
            if part["output"] == "num_points":
                part["values"] = [[7]]

    message = messages(rewritten(exported.path, other_count))
    assert message == ["24 live rows; expected 7, as the source gave"]
    five_vectors = rewritten(
        exported.path, lambda d: d.update(test_vectors=d["test_vectors"][:1] * 5)
    )
    assert messages(five_vectors) == ["vector 5 with outputs; expected 4 at most"]


def test_float16_keeps_the_vectors_with_wider_tolerances(exported):
    path = exported.path.with_name("half.onnx")
    write_float16(exported.path, path)
    vectors = loads(open_model(path).manifest_text).test_vectors
    assert vectors[0].outputs == exported.manifest.test_vectors[0].outputs
    assert vectors[0].tolerances == Tolerances(2e-3, 2e-3, 4e-3, 4e-3)
    assert messages(path) == []
    assert messages(edited(path, mirror, "edited_half.onnx")) != []


def test_a_float16_export_reproduces_its_rows(tmp_path):
    half = export(Ball(), tmp_path / "half.onnx", dtype="float16")
    assert len(half.manifest.test_vectors) == 2
    assert messages(half.path) == []


def test_recorded_digests_leave_the_rows_of_the_source(exported, tmp_path):
    recorded = record_vectors(exported.path, tmp_path / "out", count=1)
    vectors = loads(open_model(recorded.model).manifest_text).test_vectors
    assert vectors == (*exported.manifest.test_vectors, *recorded.vectors)
    assert messages(recorded.model) == []


def test_zero_vectors_on_request_and_out_of_range_is_refused(tmp_path):
    bare = export(Ball(), tmp_path / "bare.onnx", vectors=0)
    assert bare.manifest.test_vectors == ()
    with pytest.raises(ConfigInvalid, match="vectors: is 5, expected from 0 to 4"):
        export(Ball(), tmp_path / "many.onnx", vectors=5)
    assert not (tmp_path / "many.onnx").exists()


def test_images_are_not_written_into_a_manifest(exported):
    sizes = (10, 5000, 10)
    probes = [SimpleNamespace(zeros=False, inputs={"x": np.zeros(size)}) for size in sizes]
    references = SimpleNamespace(probes=probes)
    assert RowRecorder(references, range(3), 4).indices == {0, 2}
    assert RowRecorder(references, range(3), 0).indices == set()
    probes[0] = replace_zeros(probes[0])
    assert RowRecorder(references, range(3), 4).indices == {2}


def replace_zeros(probe):
    return SimpleNamespace(zeros=True, inputs=probe.inputs)
