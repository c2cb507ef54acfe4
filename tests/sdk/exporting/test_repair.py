import json
import re
from contextlib import nullcontext, suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest

from gsgen.conformance.fixtures import find, fixtures
from gsgen.contract.errors import GsgenError
from gsgen.contract.model.model_file import open_model
from gsgen.contract.spec.manifest import VectorRows
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from gsgen.sdk.exporting.repair import RepairRequest, _with_coefficients_first, repair
from support.commands import gsgen_here


def run_model(path: Path, **inputs: np.ndarray) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(path)
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(names, inputs), strict=True))


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("count_is_int64", "GO011"),
        ("rgb3_float16", "GO015"),
        ("opaque_padding", "GV018"),
        ("nan_padding", "GV018"),
    ],
)
def test_unambiguous_faults_are_repaired_and_listed(tmp_path: Path, name: str, rule: str) -> None:
    source = find(name).write(tmp_path)
    before = source.read_bytes()
    done = repair(source, tmp_path / "fixed.onnx")
    assert [repair.rule for repair in done.repairs] == [rule]
    assert done.after.verdict == "conforms"
    assert validate(tmp_path / "fixed.onnx").findings == ()
    assert source.read_bytes() == before


def test_live_rows_keep_their_bits(tmp_path: Path) -> None:
    source = find("opaque_padding").write(tmp_path)
    repair(source, tmp_path / "fixed.onnx")
    old, new = run_model(source), run_model(tmp_path / "fixed.onnx")
    (count,) = next(value for value in old.values() if value.ndim == 1)
    for name, value in old.items():
        if value.ndim == 2:
            np.testing.assert_array_equal(new[name][:count], value[:count])
            assert not new[name][count:].any()


def test_padding_a_colour_adds_a_channel_of_ones(tmp_path: Path) -> None:
    source = find("rgb3_float16").write(tmp_path)
    repair(source, tmp_path / "fixed.onnx")
    name = next(n for n, v in run_model(source).items() if v.ndim == 2 and v.shape[1] == 3)
    old, new = run_model(source)[name], run_model(tmp_path / "fixed.onnx")[name]
    assert new.dtype == np.float16
    np.testing.assert_array_equal(new[:, :3], old)
    assert (new[:, 3] == 1).all()


def test_the_order_of_sh_is_changed_on_request_only(tmp_path: Path) -> None:
    source = find("sh_channel_major").write(tmp_path)
    with pytest.raises(GsgenError, match="has no fault that gsgen can repair without guessing"):
        repair(source, tmp_path / "fixed.onnx")
    assert not (tmp_path / "fixed.onnx").exists()
    done = repair(source, tmp_path / "fixed.onnx", RepairRequest(channel_major=True))
    assert done.after.findings == ()
    (old,) = (v for v in run_model(source).values() if v.ndim == 2 and v.shape[1] == 48)
    (new,) = (
        v for v in run_model(tmp_path / "fixed.onnx").values() if v.ndim == 2 and v.shape[1] == 48
    )
    np.testing.assert_array_equal(new.reshape(-1, 16, 3).transpose(0, 2, 1).reshape(-1, 48), old)


def test_renaming_makes_a_viewer_find_the_outputs(tmp_path: Path) -> None:
    source = find("visionary_output_name").write(tmp_path)
    settings = Settings(target=load_target("visionary"))
    done = repair(source, tmp_path / "fixed.onnx", RepairRequest(rename=True), settings)
    assert done.after.verdict == "conforms"
    text = open_model(tmp_path / "fixed.onnx").manifest_text
    assert text is not None
    assert loads(text).outputs.gaussians.name == "gaussians"  # type: ignore[union-attr]


def test_recorded_rows_are_renamed_and_reordered_too(tmp_path: Path) -> None:
    """Models of `gsgen export` record rows of their source, by the names of outputs."""
    source, order = (
        find("source_vector_holds").write(tmp_path),
        ("num_points", "color", "gaussians"),
    )
    proto = onnx.load(source)
    outputs = {value.name: value for value in proto.graph.output}
    ordered = [outputs[name] for name in order]
    del proto.graph.output[:]
    proto.graph.output.extend(ordered)
    onnx.save(proto, source)
    done = repair(source, tmp_path / "fixed.onnx", RepairRequest(rename=True, channel_major=True))
    assert [step.description for step in done.repairs] == [
        "color is reordered to coefficient-major",
        "outputs are renamed: color → color_sh, and listed first",
    ]
    assert done.after.verdict == "conforms"
    assert "GM037" not in {finding.rule for finding in done.after.findings}
    names = [value.name for value in onnx.load(tmp_path / "fixed.onnx").graph.output]
    assert names == ["gaussians", "color_sh", "num_points"]


def test_rows_of_channels_become_rows_of_coefficients() -> None:
    rows = VectorRows("color", (0,), ((1.0, 2.0, 3.0, 4.0, 5.0, 6.0),))
    (values,) = _with_coefficients_first(rows, "color").values
    assert values == (1.0, 3.0, 5.0, 2.0, 4.0, 6.0)
    assert _with_coefficients_first(rows, "gaussians") is rows


def test_a_symbol_gets_the_size_that_is_given(tmp_path: Path) -> None:
    source = find("symbolic_capacity").write(tmp_path)
    symbols = {
        dim.dim_param
        for output in onnx.load(source).graph.output
        for dim in output.type.tensor_type.shape.dim
        if dim.dim_param
    }
    assert symbols
    sizes = dict.fromkeys(symbols, run_model(source)["gaussians"].shape[0])
    done = repair(source, tmp_path / "fixed.onnx", RepairRequest(sizes=sizes))
    assert done.after.findings == ()


def test_a_model_without_manifest_needs_one(tmp_path: Path) -> None:
    source = find("no_manifest").write(tmp_path)
    with pytest.raises(GsgenError, match="has no manifest"):
        repair(source, tmp_path / "fixed.onnx")
    derived = gsgen_here("inspect", source, "--emit-manifest")
    (tmp_path / "manifest.json").write_text(derived.out)
    completed = gsgen_here(
        "fix", source, "-o", tmp_path / "fixed.onnx", "--manifest", tmp_path / "manifest.json"
    )
    assert completed.code == 0, completed.out + completed.err
    assert "GM001: embedded the given manifest" in completed.out
    assert gsgen_here("validate", tmp_path / "fixed.onnx", "--strict").code == 0


@pytest.mark.parametrize(
    ("words", "code", "expected_message"),
    [
        (("--size", "N"), 2, "--size: the value is 'N', expected SYMBOL=SIZE"),
        (("--size", "N=-3"), 2, "--size: the value is 'N=-3', expected SYMBOL=SIZE"),
        (("--dry-run",), 1, "has no fault that gsgen can repair without guessing"),
        (("--manifest", "none.json"), 2, "none.json: the manifest cannot be read"),
        ((), 1, "has no fault that gsgen can repair without guessing"),
    ],
)
def test_impossible_repairs_are_reported(
    tmp_path: Path, words: tuple[str, ...], code: int, expected_message: str
) -> None:
    source = find("drift").write(tmp_path)
    completed = gsgen_here("fix", source, "-o", tmp_path / "fixed.onnx", *words)
    assert completed.code == code
    assert expected_message in completed.err
    assert not (tmp_path / "fixed.onnx").exists()


def test_a_dry_run_says_as_json_what_would_change(tmp_path: Path) -> None:
    source = find("symbolic_capacity").write(tmp_path)
    here = sorted(tmp_path.iterdir())
    completed = gsgen_here("fix", source, "--dry-run", "--json", "--size", "N=5")
    assert completed.code == 0, completed.err
    document = json.loads(completed.out)
    assert document["path"] is None
    assert document["repairs"] == [{"description": "dimension N is 5", "rule": "GO004"}]
    assert [document[stage]["verdict"] for stage in ("before", "after")] == ["invalid", "conforms"]
    assert document["after"]["subject"]["uri"] == str(source)
    assert sorted(tmp_path.iterdir()) == here
    fixed_path = tmp_path / "fixed.onnx"
    completed = gsgen_here("fix", source, "-o", fixed_path, "--json", "--size", "N=5")
    assert json.loads(completed.out)["path"] == str(fixed_path)
    assert validate(fixed_path).findings == ()


def test_fixing_no_model_exits_4(tmp_path: Path) -> None:
    (tmp_path / "m.onnx").write_bytes(b"no")
    assert gsgen_here("fix", tmp_path / "m.onnx", "-o", tmp_path / "f.onnx").code == 4


@pytest.mark.parametrize("name", ["drift", "still_sh3", "still_half_sh3", "padded", "avatar"])
@pytest.mark.parametrize("version", [14, 15, 99])
def test_an_ir_version_of_tomorrow_is_lowered(tmp_path: Path, name: str, version: int) -> None:
    path = find(name).write(tmp_path)
    proto = onnx.load(path)
    outputs = {name: value.tobytes() for name, value in run_first_probe(path).items()}
    proto.ir_version = version
    path.write_bytes(proto.SerializeToString())
    hints = [finding.hint for finding in validate(path).findings if finding.rule == "GG001"]
    assert "`gsgen fix MODEL -o COPY` sets the version" in hints[0]
    done = repair(path, tmp_path / "fixed.onnx")
    assert [step.description for step in done.repairs] == [
        f"IR version {version} is declared as 10"
    ]
    assert done.after.verdict == "conforms"
    assert onnx.load(tmp_path / "fixed.onnx").ir_version == 10
    fixed = run_first_probe(tmp_path / "fixed.onnx")
    assert {name: value.tobytes() for name, value in fixed.items()} == outputs


def run_first_probe(path: Path) -> dict[str, np.ndarray]:
    """The outputs of a model where all inputs are zero."""
    session = onnxruntime.InferenceSession(path)
    dtypes = {"tensor(float)": np.float32, "tensor(int64)": np.int64, "tensor(int32)": np.int32}
    zeros = {
        entry.name: np.zeros(entry.shape, dtypes[entry.type]) for entry in session.get_inputs()
    }
    return run_model(path, **zeros)


def test_an_operator_set_of_tomorrow_is_lowered_where_no_operator_changed(tmp_path: Path) -> None:
    path = find("drift").write(tmp_path)
    proto = onnx.load(path)
    highest = load_target("core").opset[1]
    if onnx.defs.onnx_opset_version() <= highest:
        pytest.skip("the installed ONNX has no operator set above ONNX Runtime's")
    proto.opset_import[0].version, proto.ir_version = onnx.defs.onnx_opset_version(), 14
    path.write_bytes(proto.SerializeToString())
    done = repair(path, tmp_path / "fixed.onnx")
    assert [step.rule for step in done.repairs] == ["GG001", "GG001"]
    assert done.after.verdict == "conforms"
    assert onnx.load(tmp_path / "fixed.onnx").opset_import[0].version == highest


def test_versions_of_a_model_without_manifest_are_lowered(tmp_path: Path) -> None:
    path = find("drift").write(tmp_path)
    proto = onnx.load(path)
    del proto.metadata_props[:]
    proto.ir_version = 14
    path.write_bytes(proto.SerializeToString())
    repair(path, tmp_path / "fixed.onnx")
    assert onnx.load(tmp_path / "fixed.onnx").ir_version == 10
    assert not onnx.load(tmp_path / "fixed.onnx").metadata_props


# Rules whose hints may name `gsgen fix`, by the level that finds them; no manifest is derived here.
PROMISING_RULES = {
    "GG001": Level.STATIC,
    "GI005": Level.STATIC,
    "GO004": Level.STATIC,
    "GO011": Level.STATIC,
    "GO015": Level.STATIC,
    "GO020": Level.STATIC,
    "TV101": Level.STATIC,
    "TV102": Level.STATIC,
    "TV104": Level.STATIC,
    "GV002": Level.VALUES,
    "GV014": Level.VALUES,
    "GV018": Level.VALUES,
}
COMMAND = re.compile(r"`gsgen fix MODEL ([^`]*)-o COPY`")


@pytest.mark.parametrize(
    "name", [f.name for f in fixtures() if f.rule in PROMISING_RULES and f.suffix == ".onnx"]
)
def test_what_a_hint_says_of_the_command_is_true(tmp_path: Path, name: str) -> None:
    fixture = find(name)
    source, fixed_path = fixture.write(tmp_path), tmp_path / "fixed.onnx"
    settings = replace(fixture.settings, level=PROMISING_RULES[fixture.rule])
    before = validate(source, settings)
    finding = next(entry for entry in before.findings if entry.rule == fixture.rule)
    command = COMMAND.search(finding.hint)
    words = command[1].split() if command else []
    sizes = dict(word.split("=") for word in words if "=" in word)
    request = RepairRequest(
        sizes={symbol: int(size) for symbol, size in sizes.items()},
        rename="--rename" in words,
        channel_major="channel-major" in words,
    )
    with suppress(GsgenError) if command is None else nullcontext():
        repair(source, fixed_path, request, settings)
    if not fixed_path.exists():
        return
    after = validate(fixed_path, settings)
    assert command is None or fixture.rule not in {entry.rule for entry in after.findings}
    errors = {e.rule for e in before.findings if e.severity is Severity.ERROR}
    assert {e.rule for e in after.findings if e.severity is Severity.ERROR} <= errors
