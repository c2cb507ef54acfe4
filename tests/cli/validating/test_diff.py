import json
from pathlib import Path

import numpy as np

from gsgen.conformance.fixtures import find
from support.commands import gsgen_here


def test_a_model_does_not_differ_from_its_copy(tmp_path: Path) -> None:
    path = find("drift").write(tmp_path)
    copy = tmp_path / "copy.onnx"
    copy.write_bytes(path.read_bytes())
    completed = gsgen_here("diff", path, copy)
    assert completed.code == 0
    assert "no difference" in completed.out
    assert completed.out.count("equal bits") == 3


def test_values_that_differ_are_counted_and_placed(tmp_path: Path) -> None:
    spec = find("drift").draw()
    a, b = tmp_path / "a.onnx", tmp_path / "b.onnx"
    spec.write(a)
    moved = spec.weights["center"].copy()
    moved[2, 1] += 0.25
    spec.with_weights(center=moved).write(b)
    completed = gsgen_here("diff", a, b)
    assert completed.code == 1
    assert "output  gaussians: differ by up to 0.25, in 1 rows" in completed.out
    assert "output  appearance: equal bits" in completed.out
    assert gsgen_here("diff", a, b, "--tolerance", "0.3").code == 0


def test_padding_channel_is_not_a_difference(tmp_path: Path) -> None:
    """Float16 rows of RGB have four channels, of which three are seen."""
    spec = find("still_rgb").draw()
    a, b = tmp_path / "a.onnx", tmp_path / "b.onnx"
    spec.write(a)
    colors = spec.weights["colors"]
    width = np.concatenate([colors + np.float32(0.25), np.ones_like(colors[:, :1])], axis=1)
    spec.with_weights(colors=width).replace_text(",3] color", ",4] color").write(b)
    completed = gsgen_here("diff", a, b)
    assert f"output  appearance: differ by up to 0.25, in {len(colors)} rows" in completed.out


def test_declarations_and_graphs_are_compared(tmp_path: Path) -> None:
    spec = find("drift").draw()
    a, b = tmp_path / "a.onnx", tmp_path / "b.onnx"
    spec.write(a)
    spec.with_manifest(family="4d").replace_text("Mul (speed, time)", "Add (speed, time)").write(b)
    facts = json.loads(gsgen_here("diff", a, b, "--json").out)["facts"]
    listed = {(fact["kind"], fact["name"]): fact["second"] for fact in facts}
    assert listed[("contract", "family")] == "4d"
    assert ("graph", "operator Mul") in listed


def test_models_with_other_inputs_are_not_run(tmp_path: Path) -> None:
    a, b = find("drift").write(tmp_path), find("camera_position").write(tmp_path)
    completed = gsgen_here("diff", a, b)
    assert completed.code == 1
    assert "not compared: the models take different inputs" in completed.out


def test_nan_equals_nan(tmp_path: Path) -> None:
    path = find("nan_row").write(tmp_path)
    copy = tmp_path / "copy.onnx"
    copy.write_bytes(path.read_bytes())
    assert gsgen_here("diff", path, copy).code == 0


def test_a_file_that_is_no_model_exits_4(tmp_path: Path) -> None:
    (tmp_path / "no.onnx").write_bytes(bytes(np.arange(9, dtype=np.uint8)))
    assert gsgen_here("diff", tmp_path / "no.onnx", find("drift").write(tmp_path)).code == 4


def test_cells_are_compared_as_rows_are(tmp_path: Path) -> None:
    spec = find("weighted_sum").draw()
    a, b = tmp_path / "a.onnx", tmp_path / "b.onnx"
    spec.write(a)
    spec.with_weight_values("cell_rows", np.s_[1, 4], 0.25 + spec.weights["cell_rows"][1, 4]).write(
        b
    )
    completed = gsgen_here("diff", a, b)
    assert completed.code == 1
    assert "output  cells: differ by up to 0.25, in 1 rows" in completed.out
    assert "output  gaussians: equal bits" in completed.out
