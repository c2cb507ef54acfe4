"""Generators whose Gaussians lie in cells: packed, exported, compared, read back, halved."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from gsgen.conformance.fixtures import find
from gsgen.contract.errors import LayoutMismatch
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.probes import Probe
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.layout import decode_cells
from gsgen.contract.spec.manifest import CellsOutput, WeightedSum
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.sdk import Cells, Gaussians, GeneratorInvalid, export, inputs
from gsgen.sdk import wrap as wrapped
from gsgen.sdk.authoring.packed_module import Packed, PackedGenerator
from gsgen.sdk.binding import FrameSession
from gsgen.sdk.exporting.constant_generator import write_constant
from gsgen.sdk.exporting.pipeline import Exported
from gsgen.sdk.float16.convert_model import write_float16
from gsgen.sdk.live.comparison import disagreements
from gsgen.sdk.live.level import Frame, LiveLevel
from support.models.generators import CELLS, EACH, WEIGHTS, Bunches


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Exported:
    path = tmp_path_factory.mktemp("cells") / "bunches.onnx"
    return export(Bunches(), path, settings=Settings(level=Level.VALUES))


def eager(time: float) -> Gaussians:
    with torch.no_grad():
        return Bunches()(torch.full((1,), time))


def test_cells_are_declared_and_compared(exported: Exported) -> None:
    manifest = exported.manifest
    assert (manifest.contract, manifest.blend) == ("1.0", "wsr")
    assert manifest.weighted_sum == WEIGHTS
    assert manifest.outputs.cells == CellsOutput("cells", EACH, "float32")
    assert exported.report.findings == ()
    fields = {field.field for field in exported.parity.fields}
    assert {"cell position", "cell covariance", "cell visibility"} <= fields


def test_a_session_gives_the_cells_of_live_rows(exported: Exported) -> None:
    with FrameSession(exported.path, provider="cpu") as session:
        frame = session.run({"time": 0.5})
        known = eager(0.5).cells
        assert known is not None
        actual = decode_cells(frame.cells)
        np.testing.assert_allclose(actual.position, known.position, atol=1e-6)
        np.testing.assert_allclose(actual.visibility, known.visibility[:, 0], atol=1e-6)
        np.testing.assert_allclose(actual.covariance, known.covariances(), atol=1e-6)
        np.testing.assert_array_equal(frame[exported.manifest.outputs.cells.name], frame.cells)
        assert 0 < (actual.visibility == 0).sum() < CELLS


def test_a_frame_of_a_model_without_cells_has_none(tmp_path: Path) -> None:
    path = find("still_sh0").write(tmp_path)
    with (
        FrameSession(path, provider="cpu") as session,
        pytest.raises(LayoutMismatch, match="the output that holds the cells"),
    ):
        _ = session.run({}).cells


def test_cells_go_into_half_precision_with_their_rows(exported: Exported, tmp_path: Path) -> None:
    halved = write_float16(exported.path, tmp_path / "half.onnx")
    assert {"cell position", "cell visibility"} <= {field.field for field in halved.parity.fields}
    subject = inspect_model(open_model(tmp_path / "half.onnx"), load_target("core"), Limits())
    assert subject.declared_cells == CellsOutput("cells", EACH, "float16")
    assert subject.cells is not None
    assert subject.cells.dtype == "float16"


# ---- Packing -----------------------------------------------------------------------------------


def test_cells_behind_the_count_are_not_visible() -> None:
    class Counted(Bunches):
        def forward(self, time: torch.Tensor) -> Gaussians:
            outputs = super().forward(time)
            return replace(outputs, count=torch.tensor([7]))

    packed = PackedGenerator(Counted(), Packed(torch.float32, (CELLS + 1) * EACH))
    with torch.no_grad():
        rows, _, count, cells = packed(torch.ones(1))
    assert count.item() == 7
    assert cells.shape == (CELLS + 1, 10)
    assert (cells[:3, 3] == 0.75).all()
    assert (cells[3:, 3] == 0).all()
    assert (rows[7:, 3] == 0).all()
    assert (cells[CELLS] == 0).all()


def test_a_capacity_that_splits_a_cell_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        GeneratorInvalid, match=r"(?s)25 packed Gaussians are not a multiple of 3.* 3 divides"
    ):
        export(Bunches(), tmp_path / "m.onnx", capacity=25)
    assert not (tmp_path / "m.onnx").exists()


@pytest.mark.parametrize(
    ("weights", "has_cells", "expected_message"),
    [(None, True, "weighted_sum is not set"), (WEIGHTS, False, "forward returns no cells")],
)
def test_cells_and_weights_go_together(
    weights: WeightedSum | None, has_cells: bool, expected_message: str, tmp_path: Path
) -> None:
    class Half(Bunches):
        weighted_sum = weights

        def forward(self, time: torch.Tensor) -> Gaussians:
            outputs = super().forward(time)
            return outputs if has_cells else replace(outputs, cells=None)

    with pytest.raises(GeneratorInvalid, match=f"(?s)Half: .*{expected_message}"):
        export(Half(), tmp_path / "m.onnx")


@pytest.mark.parametrize(
    ("changes", "expected_message"),
    [
        ({"position": torch.zeros(CELLS, 2)}, r"Cells.position: shape is \[8, 2\]"),
        ({"visibility": torch.zeros(CELLS, 3)}, r"Cells.visibility.*\[8\] or \[8, 1\]"),
        (
            {"scale": None},
            "Cells: the extent is missing or given twice, expected either scale and rotation, or covariance",
        ),
        (
            {"covariance": torch.zeros(CELLS, 6)},
            "Cells: the extent is missing or given twice, expected either scale and rotation, or covariance",
        ),
    ],
)
def test_cells_of_another_shape_are_refused(
    changes: dict[str, object], expected_message: str
) -> None:
    known = eager(1.0).cells
    with pytest.raises(GeneratorInvalid, match=expected_message):
        replace(known, **changes)  # type: ignore[type-var]


def test_cells_that_rows_do_not_fill_are_refused() -> None:
    outputs = eager(1.0)
    few_cells = Cells(torch.zeros(5, 3), torch.ones(5), covariance=torch.zeros(5, 6))
    with pytest.raises(GeneratorInvalid, match="24 Gaussians do not fill 5 cells"):
        replace(outputs, cells=few_cells)
    none = Cells(torch.zeros(0, 3), torch.ones(0), covariance=torch.zeros(0, 6))
    with pytest.raises(GeneratorInvalid, match="do not fill 0 cells"):
        replace(outputs, cells=none)


def test_single_rows_do_not_leave_their_cells() -> None:
    with pytest.raises(GeneratorInvalid, match="out of their cells"):
        eager(1.0).take(torch.arange(4))


# ---- Wrapping ----------------------------------------------------------------------------------


FIELDS = {name: name for name in ("position", "opacity", "scale", "rotation", "rgb", "cells")}


def test_a_module_with_cells_is_wrapped() -> None:
    generator = wrapped(Bunches(), inputs=[inputs.time()], outputs=FIELDS, weighted_sum=WEIGHTS)
    with torch.no_grad():
        result = generator(torch.full((1,), 0.5))
    assert generator.weighted_sum == WEIGHTS
    known = eager(0.5).cells
    assert known is not None
    assert torch.equal(result.cells.visibility, known.visibility)


def test_cells_of_a_wrapped_module_must_be_cells() -> None:
    outputs = FIELDS | {"cells": "position"}
    generator = wrapped(Bunches(), inputs=[inputs.time()], outputs=outputs)
    with pytest.raises(GeneratorInvalid, match=r"outputs\['cells'\].*expected gsgen.sdk.Cells"):
        generator(torch.ones(1))


def test_rows_that_never_change_are_written_without_cells(
    exported: Exported, tmp_path: Path
) -> None:
    rows, color = np.zeros((24, 10), np.float32), np.zeros((24, 3), np.float32)
    with pytest.raises(GeneratorInvalid, match="the manifest declares cells"):
        write_constant(rows, color, exported.manifest, tmp_path / "m.onnx")


# ---- The CPU against the GPU -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cell", "column", "factor", "field"),
    [
        (3, 0, 0.1, "cell position"),
        (3, 3, 0.1, "cell visibility"),
        (3, 9, 0.1, "cell covariance"),
        (3, 0, 5e-5, ""),
    ],
)
def test_cells_of_both_devices_are_compared(
    exported: Exported, cell: int, column: int, factor: float, field: str
) -> None:
    subject = inspect_model(open_model(exported.path), load_target("core"), Limits())
    with FrameSession(exported.path, provider="cpu") as session:
        frame = session.run({"time": 1.0})
        cpu = {name: np.array(frame[name]) for name in frame}
    gpu = {name: value.copy() for name, value in cpu.items()}
    gpu["cells"][cell, column] += factor
    frame = Frame(Probe(label="p", inputs={}), cpu, gpu, None)
    live = LiveLevel(
        subject=subject, adapter="a", nodes=(), is_capture_accepted=True, stop=None, frames=(frame,)
    )
    actual = [disagreement for disagreement, _, _ in disagreements(live)]
    assert actual == ([f"field {field}"] if field else [])
