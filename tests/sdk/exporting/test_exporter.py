from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from gsgen.contract.errors import GsgenError
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest import Space
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk import (
    ExportFailed,
    ExportRejected,
    GaussianGenerator,
    Gaussians,
    GeneratorInvalid,
    ParityFailed,
    export,
    inputs,
)
from gsgen.sdk.passes.framework.base import RewriteTarget
from gsgen.sdk.rewriting.rewrite import graph_stats
from support.models.generators import Drift, Growing, Lit, Skinned

Exported = Callable[..., Path]
KINDS = {"drift": Drift, "lit": Lit, "growing": Growing, "skinned": Skinned}


@pytest.mark.parametrize("dtype", ["float32", "float16"])
@pytest.mark.parametrize("kind", KINDS)
def test_generators_of_every_sort_export_and_conform(
    exported: Exported, kind: str, dtype: str
) -> None:
    report = validate(exported(KINDS[kind], dtype), Settings(fail_on=Severity.INFO))
    assert report.findings == ()
    assert report.capacity == 256


def test_names_are_ones_that_the_visionary_viewer_binds_right(exported: Exported) -> None:
    for kind, dtype in ((Drift, "float32"), (Lit, "float16")):
        settings = Settings(target=load_target("visionary"))
        report = validate(exported(kind, dtype), settings)
        assert report.findings == ()
        assert report.outcome("TV103").status == "pass"


@pytest.mark.parametrize("degree", [0, 2])  # 3 is that of the other tests
def test_sh_keeps_coefficient_major_order(tmp_path: Path, degree: int) -> None:
    generator = Drift(degree=degree)
    export(generator, tmp_path / "m.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "m.onnx")
    (color,) = session.run(["color_sh"], {"time": np.zeros(1, np.float32)})
    np.testing.assert_array_equal(color, generator.sh.numpy().reshape(50, -1))
    assert open_model(tmp_path / "m.onnx").manifest_text


def test_rows_behind_the_count_are_inert(exported: Exported) -> None:
    session = onnxruntime.InferenceSession(exported(Growing))
    for time, count in ((0.0, 5), (0.5, 10), (1.0, 15)):
        rows, _, actual = session.run(None, {"time": np.float32([time])})
        assert actual.dtype == np.int32
        assert actual.tolist() == [count]
        assert (rows[:count, 3] > 0.6).all()
        assert (rows[count:, 3] == 0).all()


@pytest.mark.parametrize("make", [Growing, Skinned])
def test_an_export_is_captured_by_every_release_that_is_known(
    make: type[GaussianGenerator], exported: Exported
) -> None:
    """Growing computes in int64 and with masks; Skinned joins nine columns."""
    path = exported(make)
    goal = RewriteTarget.of(load_target("core"))
    assert "onnxruntime-web 1.22.0 (JSEP)" in {table.runtime for table in goal.tables}
    assert graph_stats(path, goal).uncaptured == ()
    concat_nodes = [node for node in onnx.load(path).graph.node if node.op_type == "Concat"]
    assert max(len(node.input) for node in concat_nodes) <= 7


def test_the_opset_is_what_every_runtime_has_kernels_for(exported: Exported) -> None:
    proto = open_model(exported(Lit)).proto
    assert [(entry.domain, entry.version) for entry in proto.opset_import] == [("", 18)]


class Wide(Drift):
    """ReduceMean takes its axes as an input from operator set 18 on, and torch finds no way back."""

    def forward(self, time: torch.Tensor) -> Gaussians:
        outputs = super().forward(time)
        scale = outputs.position.mean(dim=1, keepdim=True).abs().expand(50, 3)
        return Gaussians(outputs.position, outputs.opacity, scale, outputs.rotation, sh=outputs.sh)


def test_an_opset_that_torch_silently_does_not_reach_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportFailed, match="operator set 16; it has 18") as caught:
        export(Wide(), tmp_path / "m.onnx", opset=16)
    assert caught.value.hint == "Export at operator set 18."


def test_file_contains_no_paths_of_the_author_s_machine(exported: Exported) -> None:
    data = exported(Lit).read_bytes()
    assert b"site-packages" not in data
    assert str(Path(__file__).parent).encode() not in data


def test_outputs_end_on_operators_that_capture_records(tmp_path: Path) -> None:
    class Reshaping(Drift):
        def forward(self, time: torch.Tensor) -> Gaussians:
            outputs = super().forward(time)
            return Gaussians(
                outputs.position,
                outputs.opacity,
                outputs.scale,
                outputs.rotation,
                sh=self.sh + time,
            )

    export(Reshaping(), tmp_path / "m.onnx")
    model = onnx.load(tmp_path / "m.onnx")
    makers = {name: node.op_type for node in model.graph.node for name in node.output}
    assert {makers[output.name] for output in model.graph.output} <= {"Mul", "Concat", "Cast"}


class Baked(Drift):
    """Turns time into a constant while tracing, as a numpy round trip does."""

    def forward(self, time: torch.Tensor) -> Gaussians:
        return super().forward(torch.from_numpy(np.array(time.detach().tolist(), np.float32)))


def test_a_constant_baked_by_tracing_is_an_error_and_nothing_is_written(tmp_path: Path) -> None:
    with pytest.raises((ParityFailed, ExportFailed)) as caught:
        export(Baked(), tmp_path / "m.onnx")
    assert caught.value.hint
    assert list(tmp_path.iterdir()) == []


class Remembering(Drift):
    """Python state that tracing freezes: the export differs from the second frame on."""

    calls = 0

    def forward(self, time: torch.Tensor) -> Gaussians:
        outputs = super().forward(time)
        self.calls += 1
        return Gaussians(
            outputs.position + self.calls,
            outputs.opacity,
            outputs.scale,
            outputs.rotation,
            sh=self.sh,
        )


def test_parity_names_the_field_the_gaussian_and_the_probe(tmp_path: Path) -> None:
    with pytest.raises(ParityFailed) as caught:
        export(Remembering(), tmp_path / "m.onnx")
    text = str(caught.value)
    assert "position of Gaussian" in text
    assert "for the test inputs" in text
    assert list(tmp_path.iterdir()) == []


class Branching(Drift):
    def forward(self, time: torch.Tensor) -> Gaussians:
        if time.item() > 0.5:
            time = time * 2
        return super().forward(time)


def test_a_branch_on_data_is_refused_with_the_line_of_user_code(tmp_path: Path) -> None:
    with pytest.raises(ExportFailed) as caught:
        export(Branching(), tmp_path / "m.onnx")
    assert "test_exporter.py" in caught.value.where
    assert "time.item()" in caught.value.where
    assert "torch.where" in caught.value.hint


class SomeLogits(Drift):
    """A third of the opacities are logits; a module of which most are is refused without a file."""

    def forward(self, time: torch.Tensor) -> Gaussians:
        outputs = super().forward(time)
        logit = torch.logit(outputs.opacity) * 3
        third = len(logit) // 3
        mixed = torch.cat([logit[:third], outputs.opacity[third:]])
        return Gaussians(outputs.position, mixed, outputs.scale, outputs.rotation, sh=self.sh)


def test_rejected_model_keeps_the_previous_file(tmp_path: Path) -> None:
    path = tmp_path / "m.onnx"
    path.write_text("what stood there")
    with pytest.raises(ExportRejected) as caught:
        export(SomeLogits(), path)
    assert {finding.rule for finding in caught.value.report.findings} == {"GV003"}
    assert "sigmoid" in str(caught.value)
    assert path.read_text() == "what stood there"
    assert [entry.name for entry in tmp_path.iterdir()] == ["m.onnx"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"opacity": torch.ones(7)}, "Gaussians.opacity: shape is [7], expected [5] or [5, 1]"),
        ({"sh": torch.zeros(5, 3, 16), "rgb": None}, "transpose(1, 2)"),
        ({"sh": torch.zeros(5, 48), "rgb": None}, "Reshape to [N, K, 3]"),
        ({"rgb": None}, "exactly one of sh and rgb"),
        ({"scale": None}, "scale and rotation, or covariance"),
        ({"covariance": torch.zeros(5, 6)}, "scale and rotation, or covariance"),
        ({"rotation": torch.zeros(5, 3)}, "expected [5, 4]"),
        ({"count": torch.zeros(2)}, "expected one element"),
    ],
)
def test_wrong_shapes_are_named_before_anything_is_traced(
    change: dict[str, torch.Tensor | None], words: str
) -> None:
    fields: dict[str, torch.Tensor | None] = {
        "position": torch.zeros(5, 3),
        "opacity": torch.ones(5),
        "scale": torch.ones(5, 3),
        "rotation": torch.ones(5, 4),
        "rgb": torch.ones(5, 3),
    }
    with pytest.raises(GeneratorInvalid) as caught:
        Gaussians(**(fields | change))  # type: ignore[arg-type]
    assert words in str(caught.value)


def test_forward_must_return_gaussians(tmp_path: Path) -> None:
    class Tuple(Drift):
        def forward(self, time: torch.Tensor) -> Gaussians:
            return (self.rest, self.scale)  # type: ignore[return-value]

    with pytest.raises(GeneratorInvalid, match="returned tuple"):
        export(Tuple(), tmp_path / "m.onnx")


def test_the_same_name_twice_is_refused(tmp_path: Path) -> None:
    class Twice(Drift):
        inputs = (inputs.time(), inputs.time())

    with pytest.raises(GeneratorInvalid, match="two inputs are named 'time'"):
        export(Twice(), tmp_path / "m.onnx")


def test_a_capacity_below_the_gaussians_is_refused(tmp_path: Path) -> None:
    with pytest.raises(GeneratorInvalid, match="capacity 10 is less than the 50 Gaussians"):
        export(Drift(), tmp_path / "m.onnx", capacity=10)


def test_an_empty_scene_is_refused(tmp_path: Path) -> None:
    class Nothing(Drift):
        def forward(self, time: torch.Tensor) -> Gaussians:
            outputs = super().forward(time)
            return Gaussians(
                outputs.position, outputs.opacity * 0, outputs.scale, outputs.rotation, sh=self.sh
            )

    with pytest.raises(GeneratorInvalid, match="no probe gives a single finite, visible Gaussian"):
        export(Nothing(), tmp_path / "m.onnx")


def test_a_folder_that_cannot_be_made_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(GsgenError, match="cannot be written"):
        export(Drift(), tmp_path / "file" / "m.onnx")


def test_bounds_hold_the_gaussians_at_all_probes(exported: Exported) -> None:
    path = exported(Drift)
    manifest = loads(open_model(path).manifest_text)
    assert manifest.bounds is not None
    session = onnxruntime.InferenceSession(path)
    for time in np.linspace(0, 1, 8, dtype=np.float32):
        rows = session.run(["gaussians"], {"time": np.array([time])})[0][:50]
        assert (rows[:, :3] >= np.array(manifest.bounds.min) - 1e-5).all()
        assert (rows[:, :3] <= np.array(manifest.bounds.max) + 1e-5).all()


def test_generators_are_abstract() -> None:
    with pytest.raises(TypeError):
        GaussianGenerator()  # type: ignore[abstract]


def test_exporting_twice_gives_the_same_bytes(tmp_path: Path, exported: Exported) -> None:
    path = exported(Drift)
    again = export(Drift(), tmp_path / path.name, capacity=256).path
    assert again.read_bytes() == path.read_bytes()
    assert list(tmp_path.iterdir()) == [again]


class ReadsRows(GaussianGenerator):
    """As authors have it: the matrix as in a textbook, although the input is transposed."""

    inputs = (inputs.view(),)

    def __init__(self) -> None:
        super().__init__()
        self.rest = torch.rand(8, 3)

    def forward(self, view: torch.Tensor) -> Gaussians:
        rotation, translation = view[:3, :3], view[:3, 3]  # guilty
        depth = (self.rest @ rotation.T + translation)[:, 2:].abs()
        ones = torch.ones(8, 3)
        turn = torch.tensor([[1.0, 0, 0, 0]]).repeat(8, 1)
        return Gaussians(self.rest, 1 / (1 + depth[:, 0]), 0.1 * ones, turn, rgb=0.5 * ones)


def test_a_matrix_read_in_the_other_order_is_refused_with_its_line_and_a_hint_that_works(
    tmp_path: Path,
) -> None:
    with pytest.raises(ExportRejected) as caught:
        export(ReadsRows(), tmp_path / "m.onnx", verify="quick")
    assert "# guilty" in caught.value.where
    assert 'space = Space(matrix_order="row")' in caught.value.hint

    class Declared(ReadsRows):
        space = Space(matrix_order="row")

    assert export(Declared(), tmp_path / "m.onnx", verify="quick").parity.holds
