"""The operator set that kernels were written for."""

__all__ = ["LowerOpset"]

from collections.abc import Callable
from typing import ClassVar, Self

import onnx
import onnx_ir as ir

from gsgen.sdk.passes.framework.base import MAIN_DOMAIN, ErrorBudget, RewriteTarget, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import CautiousRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, rank_of, split_sizes
from gsgen.sdk.passes.lowering.write_out_activations import WriteOutActivations
from gsgen.sdk.passes.lowering.write_out_norms import WriteOutNorms

SAFEST = 18
# Of later sets nobody has compared every operator with what it was before.
_NEWEST = 26
_SPLIT_COUNTS = 18
# From this set on these work along one axis; before, along all axes from that one on.
_ALONG_ONE_AXIS = 13
_FLATTENED = ("Hardmax", "LogSoftmax", "Softmax")
_EIGHT_BITS = ("FLOAT8", "FLOAT4", "INT4", "UINT4", "INT2", "UINT2")
# Attributes that came later, and what they say where an operator is as it was before.
_NEW_ATTRIBUTES: dict[str, Callable[[ir.Attr], bool]] = {
    "block_size": lambda one: one.as_int() == 0,
    "dilations": lambda one: all(step == 1 for step in one.as_ints()),
    "output_dtype": lambda one: one.as_int() == 0,
    "precision": lambda one: one.as_int() == 0,
    "round_mode": lambda one: one.as_string() == "up",
    "saturate": lambda one: one.as_int() == 1,  # and no eight-bit floats, which are checked
    "noop_with_empty_axes": lambda one: one.as_int() == 0,
}
# Values of attributes that an earlier set does not know.
_NEW_VALUES = {
    ("Pad", "mode"): "wrap",
    ("Resize", "coordinate_transformation_mode"): "half_pixel_symmetric",
}
_RENAMED = {"linear": "bilinear", "cubic": "bicubic"}
_REDUCTIONS = (
    "ReduceL1",
    "ReduceL2",
    "ReduceLogSum",
    "ReduceLogSumExp",
    "ReduceMax",
    "ReduceMean",
    "ReduceMin",
    "ReduceProd",
    "ReduceSumSquare",
)


class LowerOpset(CautiousRewrite):
    """Lower the operator set to one that the target has kernels for: 18.

    ONNX Runtime matches a kernel only up to the last version of its operator that the kernel was
    written for. From operator set 22 on Sin, Cos and a dozen others are of a newer version, from 20
    on GridSample; they fall to the CPU, and graph capture is refused for the whole model. Almost
    always, the newer version only allows more dtypes::

        opset 22: Sin(x)                      →   opset 18: Sin(x)
        opset 20: GridSample<mode = linear>   →   opset 18: GridSample<mode = bilinear>

    Operators that are new are written out where there is a formula. If one node has no equal, or its
    dtypes were not allowed, the whole model stays as it is, and the pass names that node.
    """

    name: ClassVar[str] = "lower-opset"
    exactness: ClassVar[ErrorBudget] = ErrorBudget(relative=1e-5, absolute=1e-7)
    wanted_by: ClassVar[str] = "targets with operator tables, or --opset"

    def __init__(self, wanted: int = SAFEST, most_ir: int | None = None) -> None:
        super().__init__()
        self.wanted, self.most_ir = wanted, most_ir

    @classmethod
    def for_goal(cls, goal: RewriteTarget) -> Self | None:
        """Return the pass for the set that was wished for, or for the safest one."""
        if goal.opset is None and not goal.tables:
            return None
        return cls(goal.opset or SAFEST, goal.target.ir)

    def rewrite(self, model: ir.Model) -> None:
        """Lower the set if every node has an equal in the lower one."""
        if self.opset > self.wanted and self._can_be_lowered(model):
            for node in list(model.graph.all_nodes()):
                if node.domain in MAIN_DOMAIN:
                    self._lower(node)
            for domain in MAIN_DOMAIN:
                if domain in model.opset_imports:
                    model.opset_imports[domain] = self.wanted
            self.changed = self.changed or [f"operator set {self.opset}"]
        if self.most_ir is not None and model.ir_version > self.most_ir:
            self.changed.append(f"IR version {model.ir_version}")
            model.ir_version = self.most_ir

    def _can_be_lowered(self, model: ir.Model) -> bool:
        for node in model.graph.all_nodes():
            if node.domain in MAIN_DOMAIN:
                why = self._obstacle(node)
                if why:
                    self.refuse(node, why)
        return not self.refusals

    def _obstacle(self, node: ir.Node) -> str:
        """Say what stands against ``node`` in the lower set; nothing if nothing does."""
        if self.opset > _NEWEST:
            return f"operator set {self.opset} is newer than this pass"
        new, old = (_schema(node.op_type, opset) for opset in (self.opset, self.wanted))
        if new is None or (old is not None and new.since_version == old.since_version):
            return ""
        if self._written_out(node, old):
            return (
                "" if self._writer(node).suits(node) else "its dtype or rank is not known"
            )
        if old is None:
            return f"operator set {self.wanted} has no {node.op_type}"
        if is_op(node, "GridSample") and rank_of(node.inputs[0]) != 4:
            return "GridSample took four axes before operator set 20"
        if is_op(node, *_FLATTENED) and old.since_version < _ALONG_ONE_AXIS:
            return f"{node.op_type} flattened before operator set {_ALONG_ONE_AXIS}"
        if is_op(node, "AveragePool") and "ceil_mode" in node.attributes:
            return "AveragePool counted otherwise before operator set 19"
        return _arguments(node, old) or _attributes(node, old) or _dtypes(node, old)

    def _written_out(self, node: ir.Node, old: onnx.defs.OpSchema | None) -> bool:
        kinds = WriteOutNorms.kinds | WriteOutActivations.kinds
        # Of GroupNormalization, the scale was one number a group.
        return node.op_type in kinds and (old is None or is_op(node, "GroupNormalization"))

    def _writer(self, node: ir.Node) -> WriteOutNorms | WriteOutActivations:
        made = (
            WriteOutNorms()
            if node.op_type in WriteOutNorms.kinds
            else WriteOutActivations()
        )
        made.opset = self.opset
        return made

    def _lower(self, node: ir.Node) -> None:
        new, old = (_schema(node.op_type, opset) for opset in (self.opset, self.wanted))
        if new is None or (old is not None and new.since_version == old.since_version):
            return
        self.note(node)
        if self._written_out(node, old):
            self._writer(node).replace(node)
            return
        assert old is not None
        if is_op(node, "GridSample") and "mode" in node.attributes:
            mode = node.attributes["mode"].as_string()
            node.attributes["mode"] = ir.AttrString("mode", _RENAMED.get(mode, mode))
        if is_op(node, *_REDUCTIONS) and self.wanted < 18:
            _axes_as_attribute(node)
        if is_op(node, "Split") and self.wanted < _SPLIT_COUNTS and len(node.inputs) < 2:
            sizes = split_sizes(node) or []
            node.resize_inputs(2)
            node.replace_input_with(1, InsertionPoint(node).whole(*sizes))
            node.attributes.pop("num_outputs", None)
        for name in list(node.attributes):
            if name not in old.attributes:
                del node.attributes[name]


def _schema(kind: str, opset: int) -> onnx.defs.OpSchema | None:
    try:
        return onnx.defs.get_schema(kind, opset, "")
    except onnx.defs.SchemaError:
        return None


def _axes_as_attribute(node: ir.Node) -> None:
    axes = constant_of(node.inputs[1]) if len(node.inputs) > 1 else None
    if axes is not None:
        node.attributes["axes"] = ir.AttrInt64s("axes", [int(axis) for axis in axes])
    node.resize_inputs(1)


def _arguments(node: ir.Node, old: onnx.defs.OpSchema) -> str:
    """Say which argument the older operator does not take."""
    if is_op(node, *_REDUCTIONS) and len(node.inputs) == 2:
        known = node.inputs[1] is None or constant_of(node.inputs[1]) is not None
        return "" if known else "its axes are not known before the frame"
    if is_op(node, "Split") and "num_outputs" in node.attributes:
        return (
            "" if split_sizes(node) is not None else "the sizes of its parts are not known"
        )
    count = len([value for value in node.inputs if value is not None])
    return f"it took {old.max_input} arguments at most" if count > old.max_input else ""


def _attributes(node: ir.Node, old: onnx.defs.OpSchema) -> str:
    """Say which attribute says something that the older operator cannot."""
    for name, one in node.attributes.items():
        idle = _NEW_ATTRIBUTES.get(name)
        fresh = name not in old.attributes and name not in ("axes", "num_outputs")
        if fresh and (idle is None or not idle(one)):
            return f"it had no attribute {name!r}"
        banned = _NEW_VALUES.get((node.op_type, name))
        if banned is not None and one.as_string() == banned:
            return f"its {name} could not be {banned!r}"
    return ""


def _dtypes(node: ir.Node, old: onnx.defs.OpSchema) -> str:
    """Say which dtype the older operator did not take."""
    for formal, values in ((old.inputs, node.inputs), (old.outputs, node.outputs)):
        for place, value in enumerate(values):
            if value is None or value.dtype is None or not formal:
                continue
            if value.dtype.name.startswith(_EIGHT_BITS):
                return f"it did not take {value.dtype.name}"
            allowed = formal[min(place, len(formal) - 1)].types
            if str(value.type) and allowed and _type_name(value) not in allowed:
                return f"it did not take {_type_name(value)}"
    return ""


def _type_name(value: ir.Value) -> str:
    assert value.dtype is not None
    return f"tensor({onnx.TensorProto.DataType.Name(int(value.dtype)).lower()})"
