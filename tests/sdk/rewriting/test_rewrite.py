"""The pipeline: any ONNX model, compared before and after, and written whole or not at all."""

import json
from pathlib import Path
from typing import ClassVar

import numpy as np
import onnx
import onnx_ir as ir
import onnxruntime
import pytest
from typer.testing import CliRunner

from gsgen.cli.command_group import build
from gsgen.conformance.fixtures import find
from gsgen.contract.errors import ConfigInvalid, ModelUnreadable, UnknownName
from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.spec.manifest_io import parse
from gsgen.contract.spec.targets import known_targets, load_target
from gsgen.sdk.errors import RewriteFailed
from gsgen.sdk.passes.framework.base import (
    BIT_EXACT,
    ErrorBudget,
    NodeRewrite,
    RewriteTarget,
    is_op,
)
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.registry import REWRITES
from gsgen.sdk.rewriting import rewrite as pipeline
from gsgen.sdk.rewriting.model_io import save_model
from gsgen.sdk.rewriting.rewrite import graph_stats, rewrite_file, rewrite_graph
from support.models.small_models import good_rows, save_moving
from support.passes import HEAD, operators, parsed

CORE, WEBGPU = load_target("core"), load_target("webgpu")
ROUNDED = "g (float[2,3] x) => (float[2,3] y) { r = Round (x) y = Identity (r) }"


def write_model(path: Path, text: str, head: str = HEAD) -> Path:
    path.write_bytes(onnx.parser.parse_model(head + text).SerializeToString())
    return path


class Scale(NodeRewrite):
    """Multiply the result of Neg: a pass that is wrong by as much as it is told to be."""

    name: ClassVar[str] = "scale"
    by = 1.0
    done = False

    def matches(self, node: ir.Node) -> bool:
        return is_op(node, "Neg") and not type(self).done

    def replace(self, node: ir.Node) -> None:
        type(self).done = True
        write = InsertionPoint(node)
        negative = write.op("Neg", node.inputs[0])
        factor = write.constant(np.asarray(self.by, np.float32))
        write.replace(write.op("Mul", negative, factor))


@pytest.fixture
def scaling(monkeypatch):
    """Let the pipeline run :class:`Scale` alone."""

    def choose(by: float, exactness: ErrorBudget) -> None:
        monkeypatch.setattr(Scale, "by", by)
        monkeypatch.setattr(Scale, "done", False)
        monkeypatch.setattr(Scale, "exactness", exactness)
        monkeypatch.setattr(pipeline, "find_rewrites", lambda *_: [Scale()])

    return choose


# ---- What it does ----------------------------------------------------------------------------


def test_a_model_without_a_manifest_is_rewritten_and_compared(tmp_path: Path) -> None:
    source = write_model(tmp_path / "in.onnx", ROUNDED)
    done = rewrite_file(source, tmp_path / "out.onnx", WEBGPU)
    assert {change.rewrite for change in done.changes} >= {"round-by-floor", "drop-idle"}
    assert [len(array.uncaptured) for array in (done.before, done.after)] == [1, 0]
    assert done.before.uncaptured == ("r (Round float32): falls to the CPU",)
    assert (done.probes, done.differences) == (5, ())
    session = onnxruntime.InferenceSession(tmp_path / "out.onnx")
    x = np.array([[0.5, 1.5, -2.5], [3.2, 1e9, -0.0]], np.float32)
    np.testing.assert_array_equal(session.run(None, {"x": x})[0], np.rint(x))


def test_a_manifest_stays_and_its_probes_are_run(tmp_path: Path) -> None:
    source = save_moving(tmp_path / "in.onnx", good_rows(8))
    done = rewrite_file(source, tmp_path / "out.onnx", CORE)
    assert done.probes == 9
    before, after = (
        {entry.key: entry.value for entry in onnx.load(tmp_path / name).metadata_props}
        for name in ("in.onnx", "out.onnx")
    )
    assert before == after


def test_nothing_to_do_gives_a_copy_that_computes_the_same(tmp_path: Path) -> None:
    source = write_model(tmp_path / "in.onnx", "g (float[2] x) => (float[2] y) { y = Neg (x) }")
    done = rewrite_file(source, tmp_path / "out.onnx", WEBGPU)
    assert done.changes == ()
    assert onnx.load(tmp_path / "out.onnx").graph.node[0].op_type == "Neg"


def test_a_dry_run_compares_and_writes_nothing(tmp_path: Path) -> None:
    source = write_model(tmp_path / "in.onnx", ROUNDED)
    done = rewrite_file(source, None, WEBGPU)
    assert done.path is None
    assert done.changes
    assert [file.name for file in tmp_path.iterdir()] == ["in.onnx"]


def test_passes_may_be_chosen_and_skipped(tmp_path: Path) -> None:
    source = write_model(tmp_path / "in.onnx", ROUNDED)
    single_pass = rewrite_file(source, None, WEBGPU, only=["round-by-floor"])
    assert [change.rewrite for change in single_pass.changes] == ["round-by-floor"]
    without_pass = rewrite_file(source, None, WEBGPU, skip=["round-by-floor"])
    assert "round-by-floor" not in {change.rewrite for change in without_pass.changes}


def test_functions_and_branches_are_reached(tmp_path: Path) -> None:
    head = '<ir_version: 8, opset_import: ["" : 18, "own" : 1]> '
    text = (
        "g (bool c, float[3] x) => (float[3] y) { y = If (c) <"
        "then_branch = t () => (float[3] a) { a = own.half (x) }, "
        "else_branch = e () => (float[3] b) { b = Neg (x) }> } "
        '<domain: "own", opset_import: ["" : 18]> half (v) => (w) { r = Round (v) w = Abs (r) }'
    )
    source = write_model(tmp_path / "in.onnx", text, head)
    done = rewrite_file(source, tmp_path / "out.onnx", WEBGPU)
    loaded = ir.load(tmp_path / "out.onnx")
    assert not loaded.functions
    assert "Round" not in operators(loaded)
    assert "round-by-floor" in {change.rewrite for change in done.changes}


def test_weights_beside_the_model_stay_beside_it(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    model = parsed("g (float[64,64] x) => (float[64,64] y) { r = Round (x) y = Add (r, w) }")
    weight = np.random.default_rng(0).normal(size=(64, 64)).astype(np.float32)
    (add_node,) = (node for node in model.graph if node.op_type == "Add")
    value = add_node.inputs[1]
    value.const_value = ir.tensor(weight, name="w")
    value.type, value.shape = ir.TensorType(ir.DataType.FLOAT), ir.Shape([64, 64])
    model.graph.register_initializer(value)
    ir.save(model, tmp_path / "a" / "in.onnx", external_data="weights.bin")
    rewrite_file(tmp_path / "a" / "in.onnx", tmp_path / "b" / "out.onnx", WEBGPU)
    assert {file.name for file in (tmp_path / "b").iterdir()} == {"out.onnx", "out.onnx.data"}
    session = onnxruntime.InferenceSession(tmp_path / "b" / "out.onnx")
    x = np.full((64, 64), 2.5, np.float32)
    np.testing.assert_array_equal(session.run(None, {"x": x})[0], 2 + weight)


def test_weights_that_the_source_reads_are_not_replaced(tmp_path: Path) -> None:
    model = parsed("g (float[64] x) => (float[64] y) { r = Round (x) y = Add (r, w) }")
    (add_node,) = (node for node in model.graph if node.op_type == "Add")
    value = add_node.inputs[1]
    value.const_value = ir.tensor(np.arange(64, dtype=np.float32), name="w")
    value.type, value.shape = ir.TensorType(ir.DataType.FLOAT), ir.Shape([64])
    model.graph.register_initializer(value)
    ir.save(model, tmp_path / "a.onnx", external_data="a.onnx.data", size_threshold_bytes=0)
    renamed = (tmp_path / "a.onnx").rename(tmp_path / "old.onnx")
    before = (tmp_path / "a.onnx.data").read_bytes()
    for name in ("a.onnx", "a.onnx.data"):
        with pytest.raises(ConfigInvalid, match=r"replace a\.onnx\.data, which old\.onnx"):
            rewrite_file(renamed, tmp_path / name, WEBGPU)
    assert (tmp_path / "a.onnx.data").read_bytes() == before
    assert not (tmp_path / "a.onnx").exists()


def test_symbolic_sizes_are_given_or_guessed(tmp_path: Path) -> None:
    text = "g (float[N,2] x) => (float[N,2] y) { r = Round (x) y = Neg (r) }"
    source = write_model(tmp_path / "in.onnx", text)
    assert rewrite_file(source, None, WEBGPU).changes
    rewrite_file(source, tmp_path / "out.onnx", WEBGPU, sizes={"N": 7})
    (x,) = onnx.load(tmp_path / "out.onnx").graph.input
    assert [d.dim_value for d in x.type.tensor_type.shape.dim] == [7, 2]


# ---- What stops it ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("factor", "exactness", "is_failing"),
    [
        (1.0, BIT_EXACT, False),
        (1.0000001, BIT_EXACT, True),
        (1.0000001, ErrorBudget(relative=1e-5), False),
        (1.01, ErrorBudget(relative=1e-5), True),
        (float("nan"), ErrorBudget(relative=1e-5), True),
        (float("inf"), ErrorBudget(absolute=1e9), True),
    ],
)
def test_a_pass_that_changes_more_than_it_declares_writes_nothing(
    factor: float, exactness: ErrorBudget, is_failing: bool, scaling, tmp_path: Path
) -> None:
    scaling(factor, exactness)
    source = write_model(tmp_path / "in.onnx", "g (float[2] x) => (float[2] y) { y = Neg (x) }")
    (tmp_path / "out.onnx").write_bytes(b"old")
    if is_failing:
        with pytest.raises(
            RewriteFailed, match=r"output 'y' differs by .* for the test inputs"
        ) as caught:
            rewrite_file(source, tmp_path / "out.onnx", WEBGPU)
        assert caught.value.where == "scale"
        assert (tmp_path / "out.onnx").read_bytes() == b"old"
    else:
        rewrite_file(source, tmp_path / "out.onnx", WEBGPU)
        assert (tmp_path / "out.onnx").read_bytes() != b"old"
    assert sorted(file.name for file in tmp_path.iterdir()) == ["in.onnx", "out.onnx"]


def test_passes_that_undo_each_other_are_found_out(monkeypatch) -> None:
    monkeypatch.setattr(Scale, "matches", lambda _, node: is_op(node, "Neg"))
    monkeypatch.setattr(pipeline, "find_rewrites", lambda *_: [Scale()])
    model = parsed("g (float[2] x) => (float[2] y) { y = Neg (x) }")
    with pytest.raises(RewriteFailed, match="still changes after 20 rounds of scale"):
        rewrite_graph(model, RewriteTarget.of(WEBGPU))


def test_a_pass_that_leaves_no_valid_graph_is_found_out(monkeypatch, tmp_path: Path) -> None:
    def spoil(_, node: ir.Node) -> None:
        node.attributes["no_such"] = ir.AttrInt64("no_such", 1)

    monkeypatch.setattr(Scale, "matches", lambda _, node: "no_such" not in node.attributes)
    monkeypatch.setattr(Scale, "replace", spoil)
    monkeypatch.setattr(pipeline, "find_rewrites", lambda *_: [Scale()])
    source = write_model(tmp_path / "in.onnx", "g (float[2] x) => (float[2] y) { y = Neg (x) }")
    with pytest.raises(RewriteFailed, match="not well formed"):
        rewrite_file(source, tmp_path / "out.onnx", WEBGPU)
    assert not (tmp_path / "out.onnx").exists()


def test_a_model_that_does_not_run_cannot_be_compared(tmp_path: Path) -> None:
    text = "g (float[3] x, int64[1] s) => (float[N] y) { r = Round (x) y = Reshape (r, s) }"
    source = write_model(tmp_path / "in.onnx", text)
    with pytest.raises(
        RewriteFailed, match="before the rewrite does not run in ONNX Runtime at probe"
    ):
        rewrite_file(source, tmp_path / "out.onnx", WEBGPU)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("external_data_outside", "GS001"),
        ("external_data_missing", "GS001"),
        ("cyclic_graph", "GG019"),
        ("shape_conflict", "GG015"),
        ("unseeded_random", "other outputs for the same inputs"),
        ("custom_operator", "does not run in ONNX Runtime"),
    ],
)
def test_a_model_that_is_broken_is_refused_for_that(
    name: str, message: str, tmp_path: Path
) -> None:
    source = find(name).write(tmp_path)
    with pytest.raises(RewriteFailed, match=message):
        rewrite_file(source, tmp_path / "out.onnx", CORE)
    assert not (tmp_path / "out.onnx").exists()


@pytest.mark.parametrize(
    "name",
    [
        *("stepped_frames", "output_scattered_in_place", "int64_on_jsep", "modulo_of_time"),
        *("group_normalised", "lp_normalised_on_jsep", "sine_of_opset_22_on_jsep"),
        *("vector_product_on_jsep", "largest_of_two_on_jsep", "split_in_eight"),
    ],
)
def test_examples_that_no_release_captures_are_captured_afterwards(
    name: str, tmp_path: Path
) -> None:
    model = ir.load(find(name).write(tmp_path))
    goal = RewriteTarget.of(CORE, parse(model.metadata_props[MANIFEST_KEY]).manifest)
    rewrite_graph(model, goal)
    save_model(model, tmp_path / "out.onnx")
    assert graph_stats(tmp_path / "out.onnx", goal).uncaptured == ()


def test_an_input_that_is_an_output_keeps_its_name(tmp_path: Path) -> None:
    """It cannot be mended without another name; rule GG016 tells of it."""
    source = find("output_is_input").write(tmp_path)
    done = rewrite_file(source, tmp_path / "out.onnx", CORE)
    loaded = onnx.load(tmp_path / "out.onnx")
    assert done.path is not None
    assert {v.name for v in loaded.graph.output} == {v.name for v in onnx.load(source).graph.output}


def test_graph_shapes_override_a_mismatched_manifest(tmp_path: Path) -> None:
    source = find("view_flattened").write(tmp_path)
    assert rewrite_file(source, None, CORE).probes == 5


def test_invalid_rewrite_arguments_are_refused(tmp_path: Path) -> None:
    source = write_model(tmp_path / "in.onnx", ROUNDED)
    with pytest.raises(UnknownName, match="unknown pass 'round-by-flor'") as caught:
        rewrite_file(source, None, WEBGPU, only=["round-by-flor"])
    assert "Did you mean 'round-by-floor'?" in str(caught.value)
    with pytest.raises(ConfigInvalid, match="20 is above the model's operator set 18"):
        rewrite_file(source, None, WEBGPU, opset=20)
    (tmp_path / "no.onnx").write_bytes(b"\x00\x01")
    with pytest.raises(ModelUnreadable):
        rewrite_file(tmp_path / "no.onnx", None, WEBGPU)


# ---- The registry ----------------------------------------------------------------------------


def test_every_pass_has_a_description() -> None:
    names = [rewrite.name for rewrite in REWRITES]
    assert len(set(names)) == len(names)
    for graph_rewrite in REWRITES:
        assert graph_rewrite.summary()
        assert "::" in (graph_rewrite.__doc__ or ""), f"{graph_rewrite.name} shows no picture"
        assert graph_rewrite.exactness.describe()
        assert graph_rewrite.wanted_by
        for target in known_targets().values():
            result = graph_rewrite.for_target(RewriteTarget.of(target))
            assert result is None or result.name == graph_rewrite.name


# ---- The command -----------------------------------------------------------------------------


def gsgen(*words: str):
    return CliRunner().invoke(build(), ["rewrite", *words])


def test_the_command_reports_what_changed(tmp_path: Path) -> None:
    source = write_model(tmp_path / "in.onnx", ROUNDED)
    completed = gsgen(str(source), "-o", str(tmp_path / "out.onnx"), "--target", "webgpu")
    assert completed.exit_code == 0, completed.output
    assert "round-by-floor: 1× r (Round)" in completed.output
    assert "not captured: 1 nodes → 0" in completed.output
    assert "outputs were compared at 5 probes: equal bits" in completed.output
    assert f"wrote {tmp_path / 'out.onnx'}" in completed.output


def test_nan_outputs_are_not_compared(tmp_path: Path) -> None:
    text = (
        "g (float[2,3] x) => (float[2,3] y) <float zero = {0}> "
        "{ q = Mul (x, zero) n = Div (q, zero) r = Round (n) y = Identity (r) }"
    )
    words = str(write_model(tmp_path / "in.onnx", text)), "--dry-run", "--target", "webgpu"
    completed = gsgen(*words)
    assert completed.exit_code == 0, completed.output
    assert "nothing differs; y could not be compared" in completed.stdout
    assert "equal bits" not in completed.stdout
    assert (
        "y: no finite number at any of 5 probes, so the rewrite is not verified" in completed.stderr
    )
    assert json.loads(gsgen(*words, "--json").stdout)["unjudged"] == ["y"]


def test_the_command_prints_json(tmp_path: Path) -> None:
    source = write_model(tmp_path / "in.onnx", ROUNDED)
    completed = gsgen(str(source), "--dry-run", "--json", "--target", "webgpu")
    document = json.loads(completed.stdout)
    assert document["path"] is None
    assert {
        "name": "round-by-floor",
        "exactness": "bit for bit",
        "nodes": ["r (Round)"],
    } in document["passes"]
    assert document["after"]["uncaptured"] == []


def test_the_command_lists_its_passes() -> None:
    completed = gsgen("--list", "--target", "webgpu")
    assert completed.exit_code == 0
    assert "- chunk-concat " in completed.output
    assert "  chunk-split " in completed.output
    listed = json.loads(gsgen("--list", "--json").stdout)
    assert [row["name"] for row in listed] == [rewrite.name for rewrite in REWRITES]
    assert all(row["runs"] for row in listed if row["name"] != "freeze-dimensions")


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["in.onnx"], 2, "is missing, expected the path of the copy"),
        (["in.onnx", "-o", "out.onnx", "--pass", "chunk"], 2, "Did you mean"),
        (["in.onnx", "-o", "out.onnx", "--target", "webgp"], 2, "Did you mean 'webgpu'?"),
        (
            ["in.onnx", "-o", "out.onnx", "--size", "N"],
            2,
            "--size: the value is 'N', expected SYMBOL=SIZE",
        ),
        (["in.onnx", "-o", "out.onnx", "--opset", "21"], 2, "above the model's"),
        (["gone.onnx", "-o", "out.onnx"], 4, "cannot be read"),
        ([], 2, "MODEL is missing"),
    ],
)
def test_mistaken_command_is_explained(
    words: list[str], code: int, message: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_model(tmp_path / "in.onnx", ROUNDED)
    completed = gsgen(*words)
    text = completed.output + str(completed.exception or "")
    assert message in text
    assert completed.exit_code == code or isinstance(completed.exception, ConfigInvalid)
    assert not (tmp_path / "out.onnx").exists()


SEQUENCE_MODELS = {
    "split and take": "parts = SplitToSequence <axis = 0> (x) y = SequenceAt (parts, one)",
    "insert and join": (
        "empty = SequenceEmpty () parts = SequenceInsert (empty, x) "
        "both = SequenceInsert (parts, x) y = ConcatFromSequence <axis = 0> (both)"
    ),
    "construct": "parts = SequenceConstruct (x, x) y = ConcatFromSequence <axis = 1> (parts)",
    "erase": (
        "parts = SequenceConstruct (x, x) rest = SequenceErase (parts, one) "
        "y = ConcatFromSequence <axis = 0> (rest)"
    ),
    "length": "parts = SequenceConstruct (x, x) y = SequenceLength (parts)",
    "optional": "some = Optional (x) y = OptionalGetElement (some)",
    "optional sequence": (
        "parts = SequenceConstruct (x, x) some = Optional (parts) back = OptionalGetElement (some) "
        "y = SequenceAt (back, one)"
    ),
    "identity": (
        "parts = SequenceConstruct (x, x) same = Identity (parts) y = SequenceAt (same, one)"
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SEQUENCE_MODELS)
def test_types_of_sequences_and_optionals_survive(name: str, tmp_path: Path) -> None:
    """With nothing to rewrite the file keeps its bytes; with a pass that applies, it still loads."""
    kind = "int64" if name == "length" else "float[n, 3]"
    for tail in ("", " z = Reshape (x, flat)"):
        outputs = f"{kind} y" + (", float[12] z" if tail else "")
        text = (
            '<ir_version: 10, opset_import: ["" : 18]> graph (float[4, 3] x) => '
            f"({outputs}) <int64 one = {{1}}, int64[1] flat = {{12}}> {{ {SEQUENCE_MODELS[name]}{tail} }}"
        )
        source, target = tmp_path / "source.onnx", tmp_path / "target.onnx"
        onnx.save(onnx.parser.parse_model(text), source)
        target.unlink(missing_ok=True)
        result = rewrite_file(source, target, load_target("webgpu"))
        before, after = (onnxruntime.InferenceSession(path) for path in (source, target))
        feed = {"x": np.arange(12, dtype=np.float32).reshape(4, 3)}
        for old, new in zip(before.run(None, feed), after.run(None, feed), strict=True):
            np.testing.assert_array_equal(old, new)
        is_kept = not tail and name != "identity"  # a pass drops it
        assert is_kept == (not result.changes)
        assert is_kept == (source.read_bytes() == target.read_bytes())


def test_a_model_with_nothing_to_rewrite_keeps_its_bytes(tmp_path: Path) -> None:
    source, target = tmp_path / "source.onnx", tmp_path / "target.onnx"
    text = (
        '<ir_version: 10, opset_import: ["" : 18]> graph (float[4, 3] x) => (float[n, 3] y) '
        f"<int64 one = {{1}}> {{ {SEQUENCE_MODELS['split and take']} }}"
    )
    onnx.save(onnx.parser.parse_model(text), source)
    assert rewrite_file(source, target, load_target("core")).changes == ()
    assert source.read_bytes() == target.read_bytes()


def test_a_model_with_weights_beside_it_is_copied_whole(tmp_path: Path) -> None:
    """In its own folder the copy reads the same weights; elsewhere it has a file of its own."""
    source, elsewhere = tmp_path / "source.onnx", tmp_path / "other" / "target.onnx"
    weights = onnx.numpy_helper.from_array(np.arange(1200, dtype=np.float32), "w")
    model = onnx.parser.parse_model(
        '<ir_version: 10, opset_import: ["" : 18]> graph (float[1200] x) => (float[1200] y) '
        "{ y = Mul (x, w) }"
    )
    model.graph.initializer.append(weights)
    onnx.save(model, source, save_as_external_data=True, location="w.bin", size_threshold=0)
    elsewhere.parent.mkdir()
    for target in (tmp_path / "copy.onnx", elsewhere):
        assert rewrite_file(source, target, load_target("core")).changes == ()
        before, after = (onnxruntime.InferenceSession(path) for path in (source, target))
        feed = {"x": np.arange(1200, dtype=np.float32)}
        np.testing.assert_array_equal(before.run(None, feed)[0], after.run(None, feed)[0])
    assert (tmp_path / "copy.onnx").read_bytes() == source.read_bytes()
    assert sorted(path.name for path in elsewhere.parent.iterdir()) == [
        "target.onnx",
        "target.onnx.data",
    ]
