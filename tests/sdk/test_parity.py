from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec import layout
from gsgen.contract.spec.manifest import Tolerances
from gsgen.sdk import Gaussians, ParityFailed
from gsgen.sdk.exporting import eager_reference, verification
from gsgen.sdk.exporting.eager_reference import EagerRuns, Reference, run_eager, run_in_float64
from gsgen.sdk.exporting.parity_diagnosis import Diagnosis, ParitySuspects
from gsgen.sdk.exporting.pipeline import ExportOptions
from gsgen.sdk.exporting.prepare import manifest_of
from gsgen.sdk.exporting.source_vectors import RowRecorder
from gsgen.sdk.exporting.verification import _perturbed_probes, check_parity
from gsgen.sdk.parity import Comparison, ModelOutput, Parity, compare, references_equal
from support.models.generators import Drift


@pytest.fixture
def reference() -> Reference:
    rng = np.random.default_rng(9)
    n = 300
    root = rng.normal(size=(n, 3, 3)) * 0.1
    full = root @ root.transpose(0, 2, 1)
    upper = full[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    decoded_gaussians = layout.DecodedGaussians(
        position=rng.normal(size=(n, 3)) * 5,
        opacity=rng.uniform(0, 1, n),
        covariance=upper,
        sh=rng.normal(size=(n, 16, 3)) * 0.3,
    )
    return Reference(Probe(label="here", inputs={}), decoded_gaussians, n)


def against(
    reference: Reference, other: layout.DecodedGaussians, dtype: type = np.float32
) -> Parity:
    rows, color = layout.encode(other, dtype)
    return compare([reference], [ModelOutput(rows, color, reference.count)], Tolerances())


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
def test_rounding_to_the_storage_dtype_is_allowed(reference: Reference, dtype: type) -> None:
    assert against(reference, reference.gaussians, dtype).holds


@pytest.mark.parametrize("field", ["position", "opacity", "covariance", "sh"])
def test_an_error_in_one_row_is_found_and_placed(reference: Reference, field: str) -> None:
    value = getattr(reference.gaussians, field).copy()
    value[123] += {"position": 0.01, "opacity": 0.01, "covariance": 0.01, "sh": 0.05}[field]
    parity = against(reference, replace(reference.gaussians, **{field: value}))
    worst_field = max(parity.fields, key=lambda entry: entry.excess)
    assert not parity.holds
    assert worst_field.field == {"sh": "appearance"}.get(field, field)
    assert worst_field.row == 123
    assert worst_field.probe == "here"


@pytest.mark.parametrize("field", ["position", "opacity", "covariance", "sh"])
def test_nan_never_agrees(reference: Reference, field: str) -> None:
    value = getattr(reference.gaussians, field).copy()
    value[5] = np.nan
    assert not against(reference, replace(reference.gaussians, **{field: value})).holds


def test_a_wrong_order_of_sh_shows_as_a_wrong_colour(reference: Reference) -> None:
    sh = reference.gaussians.sh
    assert sh is not None
    swapped = sh.reshape(300, 3, 16).transpose(0, 2, 1)
    parity = against(reference, replace(reference.gaussians, sh=swapped))
    appearance = next(field for field in parity.fields if field.field == "appearance")
    assert appearance.error > 0.1


def test_position_is_measured_in_standard_deviations(reference: Reference) -> None:
    gaussians = reference.gaussians
    trace = gaussians.covariance[:, [0, 3, 5]].sum(axis=1)
    moved = gaussians.position + 0.5 * np.sqrt(trace / 3)[:, None]
    parity = against(reference, replace(gaussians, position=moved))
    position = next(field for field in parity.fields if field.field == "position")
    assert position.error == pytest.approx(0.5, rel=1e-3)


def test_another_count_is_a_failure(reference: Reference) -> None:
    rows, color = layout.encode(reference.gaussians)
    assert not compare([reference], [ModelOutput(rows, color, 299)], Tolerances()).holds


def test_two_runs_are_the_same_to_the_bit_or_within_a_tolerance() -> None:
    def reference(position: np.ndarray, count: int = 3) -> Reference:
        decoded_gaussians = layout.DecodedGaussians(
            position=position,
            opacity=np.ones(len(position)),
            covariance=np.ones((len(position), 6)),
            rgb=np.full((len(position), 3), 0.5),
        )
        return Reference(Probe(label="p", inputs={}), decoded_gaussians, count)

    points = np.arange(9.0).reshape(3, 3)
    points[0, 0] = np.nan
    known = reference(points)
    assert references_equal(known, reference(points.copy()))
    assert not references_equal(known, reference(points * (1 + 1e-6)))
    assert references_equal(known, reference(points * (1 + 1e-6)), 1e-5)
    assert not references_equal(known, reference(points * (1 + 1e-4)), 1e-5)
    assert not references_equal(known, reference(points, count=2))
    assert not references_equal(known, reference(np.concatenate([points, points])), 1e-5)


# ---- Rows that jump at a threshold -------------------------------------------------------------


def culled(n: int, missing_rows: list[int]) -> Reference:
    """A cloud of which some rows are transparent."""
    rng = np.random.default_rng(3)
    opacity = np.full(n, 0.8)
    opacity[missing_rows] = 0
    upper = np.tile([0.01, 0, 0, 0.01, 0, 0.01], (n, 1))
    decoded_gaussians = layout.DecodedGaussians(
        position=rng.normal(size=(n, 3)), opacity=opacity, covariance=upper, rgb=rng.random((n, 3))
    )
    return Reference(Probe(label="p", inputs={"time": np.float32([0.5])}), decoded_gaussians, n)


def compared_nearby(known: Reference, outputs: list[ModelOutput], near: list[Reference]) -> Parity:
    comparison = Comparison(Tolerances(), nearby=lambda _: near)
    for output in outputs:
        comparison.add(known, output)
    return comparison.parity


@pytest.mark.parametrize(
    ("n", "missing_rows", "holds"),
    [(100, [5], True), (100, [5, 6], False), (30_000, [5, 9, 20_000], True)],
)
def test_few_rows_may_match_torch_at_perturbed_inputs(
    n: int, missing_rows: list[int], holds: bool
) -> None:
    known, model = culled(n, []), culled(n, missing_rows)
    outputs = [ModelOutput(*layout.encode(model.gaussians), n)]
    assert not compare([known], outputs, Tolerances()).holds
    near = [culled(n, []), culled(n, missing_rows[:1]), culled(n, missing_rows[1:] or missing_rows)]
    parity = compared_nearby(known, outputs, near)
    assert parity.holds is holds
    assert parity.rows_at_threshold == (len(missing_rows) if holds else 0)
    assert ("at a threshold" in parity.describe()) is holds


def test_row_unreachable_by_torch_is_not_a_discontinuity() -> None:
    known, model = culled(100, []), culled(100, [7])
    outputs = [ModelOutput(*layout.encode(model.gaussians), 100)]
    near = [culled(100, []), culled(100, [8])]
    parity = compared_nearby(known, outputs, near)
    assert not parity.holds
    (worst_field,) = [field for field in parity.fields if field.excess > 1]
    assert (worst_field.field, worst_field.row) == ("opacity", 7)


def test_inputs_are_perturbed_slightly_to_both_sides() -> None:
    probe = Probe(label="p", inputs={"view": np.eye(4, dtype=np.float32), "frame": np.int32([3])})
    moved = list(_perturbed_probes(probe))
    assert len(moved) == 6
    for first, other in zip(moved[::2], moved[1::2], strict=True):
        for side in (first, other):
            assert side.inputs["view"].dtype == np.float32
            off = np.abs(side.inputs["view"] - np.eye(4))
            assert (off[~np.eye(4, dtype=bool)] == 0).all()
            np.testing.assert_allclose(np.diag(off), 1e-5, rtol=0.02)
            assert side.inputs["frame"].tolist() == [3]
        middle = (first.inputs["view"] + other.inputs["view"]) / 2
        np.testing.assert_allclose(middle, np.eye(4), atol=1e-7)


class Threshold(Drift):
    """Rows whose centre has passed a plane are gone; one stands on it at the first probe."""

    def forward(self, time: torch.Tensor) -> Gaussians:
        outputs = super().forward(time)
        edge = self.rest[7, :1] + 0.2 * self.velocity[7, :1]
        mask = (outputs.position[:, :1] <= edge).float()
        return Gaussians(
            outputs.position, outputs.opacity * mask, outputs.scale, outputs.rotation, sh=outputs.sh
        )


def test_discontinuity_shifted_by_rounding_agrees_with_torch(monkeypatch) -> None:
    module = Threshold().eval()
    references = EagerRuns(
        module, [Probe(label=f"time={t}", inputs={"time": np.float32([t])}) for t in (0.2, 0.9)]
    )
    outputs = [
        {"gaussians": rows, "color_sh": color, "num_points": np.array([reference.count])}
        for reference in references
        for rows, color in [layout.encode(reference.gaussians)]
    ]
    rows = outputs[0]["gaussians"]
    rows[7, 3] = 0 if rows[7, 3] else module.opacity[7].item()
    manifest = manifest_of(module, "m", "float32", 3)
    suspects = ParitySuspects(module, references[0].probe, (), True)
    recorder = RowRecorder(references, range(0), 0)
    options = ExportOptions(
        path=Path("m.onnx"), name="m", opset=18, target="core", settings=None, progress=print
    )
    check = partial(check_parity, Path("m.onnx"), manifest, references, suspects, options, recorder)
    monkeypatch.setattr(verification, "run_exported", lambda *_, **__: iter(outputs))
    assert check().rows_at_threshold == 1
    rows[8, 3] += 0.1
    monkeypatch.setattr(verification, "diagnose", lambda *_: Diagnosis("", "hint"))
    with pytest.raises(ParityFailed, match="opacity of Gaussian 8 differs"):
        check()


class Cancelling(Drift):
    """With all inputs zero, digits cancel that float32 does not have."""

    def forward(self, time: torch.Tensor) -> Gaussians:
        outputs = super().forward(time)
        large = (outputs.position + 1000) * (1 - 0.999 * time)
        return replace(outputs, position=(large - 1000 * (1 - 0.999 * time)) / (1 - 0.999 * time))


@pytest.mark.parametrize(
    ("error", "zeros", "holds"), [(2e-3, True, True), (0.2, True, False), (2e-3, False, False)]
)
def test_with_all_inputs_zero_a_model_may_differ_by_a_multiple_of_the_rounding_of_torch(
    error: float, zeros: bool, holds: bool
) -> None:
    module = Cancelling().eval()
    probe = Probe(label="p", inputs={"time": np.zeros(1, np.float32)}, zeros=zeros)
    reference = run_eager(module, probe)
    comparison = Comparison(
        Tolerances(), exact=lambda reference: run_in_float64(module, reference.probe)
    )
    rows, color = layout.encode(reference.gaussians)
    rows[0, 0] += error
    comparison.add(reference, ModelOutput(rows, color, reference.count))
    assert comparison.parity.holds is holds


def test_results_that_do_not_fit_are_run_again(monkeypatch) -> None:
    class Counted(Drift):
        runs = 0

        def forward(self, time: torch.Tensor) -> Gaussians:
            self.runs += 1
            return super().forward(time)

    module = Counted().eval()
    probes = [Probe(label=f"{t}", inputs={"time": np.float32([t])}) for t in (0.2, 0.9, 0.4)]
    single = EagerRuns(module, probes)[0]
    module.runs = 0
    monkeypatch.setattr(eager_reference, "MAX_KEPT_OUTPUT_BYTES", 2 * single.nbytes)
    runs = EagerRuns(module, probes[:1], [single]).with_probes(probes)
    assert [reference.probe for reference in runs] == probes
    assert module.runs == 2
    assert references_equal(runs[0], single)
    assert module.runs == 2
    assert references_equal(runs[-1], runs[2])
    assert module.runs == 4


def test_only_one_probe_is_held_at_a_time() -> None:
    known = culled(100, [])
    steps = []

    def references() -> Iterator[Reference]:
        for index in range(3):
            steps.append(f"torch {index}")
            yield known

    def outputs() -> Iterator[ModelOutput]:
        for index in range(3):
            steps.append(f"model {index}")
            yield ModelOutput(*layout.encode(known.gaussians), 100)

    assert compare(references(), outputs(), Tolerances()).probes == 3
    assert steps == [f"{kind} {index}" for index in range(3) for kind in ("torch", "model")]


@pytest.mark.parametrize("step", [1, 2, 7, 200])
@pytest.mark.parametrize("count", [0, 1, 150, 299, 300])
def test_sampled_cells_are_kept_complete(step: int, count: int) -> None:
    known = with_cells(np.full(100, 0.5))
    assert known.cells is not None
    rows, color = layout.encode(known.gaussians)
    output = ModelOutput(rows, color, count, packed_cells(known.cells)).every_nth(step)
    indices = [row for row in range(300) if row // 3 % step == 0]
    np.testing.assert_array_equal(output.rows, rows[indices])
    np.testing.assert_array_equal(output.color, color[indices])
    assert output.count == sum(row < count for row in indices)
    bare = ModelOutput(rows, color, count).every_nth(step)
    np.testing.assert_array_equal(bare.rows, rows[::step])
    assert bare.count == len(range(0, count, step))


# ---- Cells -------------------------------------------------------------------------------------


def with_cells(actual: np.ndarray) -> Reference:
    """300 Gaussians in 100 cells, the first three of each in one."""
    rng = np.random.default_rng(11)
    n = 300
    upper = np.tile([0.04, 0, 0, 0.04, 0, 0.04], (n, 1))
    opacity = np.full(n, 0.8)
    rows = layout.DecodedGaussians(
        position=rng.normal(size=(n, 3)), opacity=opacity, covariance=upper, rgb=rng.random((n, 3))
    )
    cells = layout.Cells(rng.normal(size=(100, 3)), actual, upper[::3])
    return Reference(Probe(label="p", inputs={}), rows, n, cells)


def packed_cells(cells: layout.Cells, dtype: type = np.float32) -> np.ndarray:
    columns = (cells.position, cells.visibility[:, None], cells.covariance)
    return np.concatenate(columns, axis=1).astype(dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float16])
@pytest.mark.parametrize(
    ("column", "field"), [(1, "cell position"), (3, "cell visibility"), (7, "cell covariance")]
)
def test_an_error_in_one_cell_is_found_and_placed(column: int, field: str, dtype: type) -> None:
    known = with_cells(np.full(100, 0.5))
    assert known.cells is not None
    cells = packed_cells(known.cells, dtype)
    model_output = ModelOutput(*layout.encode(known.gaussians), known.count, cells)
    assert compare([known], [model_output], Tolerances()).holds
    cells[42, column] += 0.02
    parity = compare([known], [model_output], Tolerances())
    (worst_field,) = [field for field in parity.fields if not field.excess <= 1]
    assert (worst_field.field, worst_field.row) == (field, 42)
    cells[42, column] = np.nan
    assert not compare([known], [model_output], Tolerances()).holds


def test_where_an_unseen_cell_lies_does_not_matter() -> None:
    known = with_cells(np.where(np.arange(100) == 7, 0.0, 0.5))
    assert known.cells is not None
    cells = packed_cells(known.cells)
    model_output = ModelOutput(*layout.encode(known.gaussians), known.count, cells)
    cells[7, :3] += 1.0
    assert compare([known], [model_output], Tolerances()).holds
    cells[8, :3] += 1.0
    assert not compare([known], [model_output], Tolerances()).holds


def test_cells_that_are_missing_are_a_failure() -> None:
    known = with_cells(np.full(100, 0.5))
    model_output = ModelOutput(*layout.encode(known.gaussians), known.count)
    assert not compare([known], [model_output], Tolerances()).holds
    assert references_equal(known, with_cells(np.full(100, 0.5)))
    assert not references_equal(known, with_cells(np.full(100, 0.6)))
    assert not references_equal(known, replace(known, cells=None))


def test_cells_without_a_live_row_are_not_compared() -> None:
    known = replace(with_cells(np.full(100, 0.5)), count=31)
    assert known.live_cells == 11
    assert known.cells is not None
    cells = packed_cells(known.cells)
    cells[11:, 3] = 0
    model_output = ModelOutput(*layout.encode(known.gaussians), 31, cells)
    assert compare([known], [model_output], Tolerances()).holds
    cells[10, 3] = 0
    assert not compare([known], [model_output], Tolerances()).holds
