"""Findings of graphs and limits: the place that they name, and the last row that fits."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from onnx import AttributeProto, NodeProto

from gsgen.conformance.fixtures.builders.arrays import i64
from gsgen.conformance.fixtures.builders.moving import SHIFT_NODE, drifting_model
from gsgen.contract.rules.graph.capture import _does_copy_input
from gsgen.contract.rules.graph.graph import _node_location
from gsgen.contract.rules.interface.extensions import cost_plausible
from gsgen.contract.rules.targets.limits import fits_dispatch
from gsgen.contract.spec.severity import Level
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate


@pytest.mark.parametrize(
    ("name", "location"), [("scale", "node scale (Mul)"), ("", "node Mul (Mul)")]
)
def test_node_label_is_its_name_or_operator(name: str, location: str) -> None:
    assert _node_location(NodeProto(name=name, op_type="Mul")) == location


@pytest.mark.parametrize(
    ("index", "helper"),
    [
        ("best, places = TopK (time, one) index = Cast <to = 6> (places)", True),
        (
            "rest = Mod <fmod = 1> (time, time) places = Cast <to = 7> (rest) index = Cast <to = 6> (places)",
            False,
        ),
    ],
)
def test_nodes_of_a_selection_of_rows_name_the_helper_that_makes_them(
    index: str, helper: bool, tmp_path: Path
) -> None:
    shift = f"{index} moved_by = Cast <to = 1> (index) shift = Mul (speed, moved_by)"
    model = drifting_model().replace_text(SHIFT_NODE, shift).with_weights(one=i64(1))
    settings = Settings(target=load_target("visionary"), level=Level.STATIC)
    model.write(tmp_path / "m.onnx")
    report = validate(tmp_path / "m.onnx", settings)
    expected = {f.rule: f.message for f in report.findings if f.rule in ("GG005", "GG006")}
    assert expected.keys() == {"GG005", "GG006"}
    for message in expected.values():
        assert ("keep_rows selects rows by TopK, multiply opacity by the mask" in message) is helper


@pytest.mark.parametrize(
    ("rows", "count"), [(1, 0), (65_536, 0), (65_535 * 256, 0), (65_535 * 256 + 1, 1), ("N", 0)]
)
def test_the_largest_dispatch_has_a_workgroup_for_its_last_row(rows: object, count: int) -> None:
    model = SimpleNamespace(
        target=load_target("gsgen"), gaussians=SimpleNamespace(name="g", dims=[rows, 10])
    )
    assert len(list(fits_dispatch.check(model))) == count  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("dtype", "size", "count"),
    [("float32", 4000, 0), ("float32", 3999, 1), ("float16", 2000, 0), ("float16", 1999, 1)],
)
def test_a_frame_costs_no_less_than_its_rows(dtype: str, size: int, count: int) -> None:
    cost = [SimpleNamespace(bytes=None), SimpleNamespace(bytes=size)]
    model = SimpleNamespace(
        generator=SimpleNamespace(cost=cost),
        declared_gaussians=SimpleNamespace(capacity=100, dtype=dtype),
    )
    assert len(list(cost_plausible.check(model))) == count  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("attributes", "inputs", "is_copy"),
    [
        ({"noop_with_empty_axes": 1}, 1, True),
        ({"noop_with_empty_axes": 1, "keepdims": 1}, 1, True),
        ({"noop_with_empty_axes": 0, "keepdims": 1}, 1, False),
        ({"keepdims": 1}, 1, False),
        ({"noop_with_empty_axes": 1, "axes": (0,)}, 1, False),
        ({"noop_with_empty_axes": 1}, 2, False),
    ],
)
def test_a_reduction_without_axes_copies_only_if_it_says_so(
    attributes: dict[str, int | tuple[int]], inputs: int, is_copy: bool
) -> None:
    node = NodeProto(op_type="ReduceSum", input=["x", "axes"][:inputs], output=["y"])
    for name, value in attributes.items():
        listed = value if isinstance(value, tuple) else ()
        node.attribute.append(AttributeProto(name=name, i=0 if listed else value, ints=listed))
    graph = SimpleNamespace(tensors={"axes": SimpleNamespace(dims=(2,))})
    assert _does_copy_input(graph, node) is is_copy  # type: ignore[arg-type]
