"""Lowers a model's ONNX operator set to a version for which target runtimes have kernels."""

__all__ = ["LowerOpset"]

from collections.abc import Callable
from typing import Self

import onnx
import onnx_ir as ir

from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN, SAFEST_OPSET
from gsgen.sdk.passes.framework.base import ErrorBudget, RewriteTarget, is_op
from gsgen.sdk.passes.framework.cautious_rewrite import SkippableRewrite
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint
from gsgen.sdk.passes.framework.value_facts import constant_of, rank_of, split_sizes
from gsgen.sdk.passes.lowering.write_out_activations import WriteOutActivations
from gsgen.sdk.passes.lowering.write_out_norms import WriteOutNorms

# The operators of later sets have not been compared with their earlier versions.
_NEWEST_KNOWN_OPSET = 26
_SPLIT_COUNT_OPSET = 18
# From this set on these work along one axis; before, along all axes from that axis on.
_ONE_AXIS_OPSET = 13
_FLATTENING_OPERATORS = ("Hardmax", "LogSoftmax", "Softmax")
_SMALL_DTYPES = ("FLOAT8", "FLOAT4", "INT4", "UINT4", "INT2", "UINT2")
# Attributes added later, each with a test for the value that means the earlier behaviour.
_NEW_ATTRIBUTES: dict[str, Callable[[ir.Attr], bool]] = {
    "block_size": lambda attribute: attribute.as_int() == 0,
    "dilations": lambda attribute: all(step == 1 for step in attribute.as_ints()),
    "output_dtype": lambda attribute: attribute.as_int() == 0,
    "precision": lambda attribute: attribute.as_int() == 0,
    "round_mode": lambda attribute: attribute.as_string() == "up",
    "saturate": lambda attribute: attribute.as_int() == 1,  # eight-bit floats are checked elsewhere
    "noop_with_empty_axes": lambda attribute: attribute.as_int() == 0,
}
# Attribute values that an earlier set does not have.
_NEW_VALUES = {
    ("Pad", "mode"): "wrap",
    ("Resize", "coordinate_transformation_mode"): "half_pixel_symmetric",
}
_OLD_MODE_NAMES = {"linear": "bilinear", "cubic": "bicubic"}
_REDUCTION_OPERATORS = (
    "ReduceL1", "ReduceL2", "ReduceLogSum", "ReduceLogSumExp", "ReduceMax", "ReduceMean",
    "ReduceMin", "ReduceProd", "ReduceSumSquare",
)  # fmt: skip


class LowerOpset(SkippableRewrite):
    """Lower the ONNX operator set to version 18, for which the target runtime has kernels.

    ONNX Runtime uses a kernel only up to the last version of the operator that it was written for.
    Sin, Cos and a dozen others have a newer version from operator set 22 on, GridSample from 20 on;
    they fall back to the CPU, and graph capture is refused for the whole model. Almost always, the
    newer version only allows more dtypes::

        1  opset 22: Sin(x)                      →   opset 18: Sin(x)
        2  opset 20: GridSample<mode = linear>   →   opset 18: GridSample<mode = bilinear>
        3  opset 20: Gelu(x)                     →   opset 18: its formula

    If a node has no equivalent in the lower set, or a dtype that was not allowed there, the whole
    model stays as it is, and the pass reports that node.
    """

    name = "lower-opset"
    exactness = ErrorBudget(relative=1e-5, absolute=1e-7)
    wanted_by = "targets with operator tables, or --opset"

    def __init__(self, target_opset: int = SAFEST_OPSET, max_ir_version: int | None = None) -> None:
        super().__init__()
        self.target_opset, self.max_ir_version = target_opset, max_ir_version

    @classmethod
    def for_target(cls, target: RewriteTarget) -> Self | None:
        """Return the rewrite to the requested ONNX operator set, by default version 18."""
        if target.opset is None and not target.tables:
            return None
        return cls(target.opset or SAFEST_OPSET, target.target.ir)

    def rewrite(self, model: ir.Model) -> None:
        """Lower the ONNX operator set if every node has an equivalent in the lower set."""
        if self.opset > self.target_opset and self._can_be_lowered(model):
            for node in list(model.graph.all_nodes()):
                if node.domain in MAIN_DOMAIN:
                    self._lower_node(node)
            for domain in MAIN_DOMAIN:
                if domain in model.opset_imports:
                    model.opset_imports[domain] = self.target_opset
            self.changed = self.changed or [f"operator set {self.opset}"]
        if self.max_ir_version is not None and model.ir_version > self.max_ir_version:
            self.changed.append(f"IR version {model.ir_version}")
            model.ir_version = self.max_ir_version

    def _can_be_lowered(self, model: ir.Model) -> bool:
        for node in model.graph.all_nodes():
            if node.domain in MAIN_DOMAIN:
                obstacle = self._lowering_obstacle(node)
                if obstacle:
                    self.refuse(node, obstacle)
        return not self.refusals

    def _lowering_obstacle(self, node: ir.Node) -> str:
        """Return why a node has no equivalent in the lower operator set; empty if one exists."""
        if self.opset > _NEWEST_KNOWN_OPSET:
            return f"operator set is {self.opset}, expected {_NEWEST_KNOWN_OPSET} or earlier"
        new_schema, old_schema = (
            _schema(node.op_type, opset) for opset in (self.opset, self.target_opset)
        )
        if new_schema is None or (
            old_schema is not None and new_schema.since_version == old_schema.since_version
        ):
            return ""
        if self._is_lowered_elsewhere(node, old_schema):
            return "" if self._writer(node).can_replace(node) else "its dtype or rank is not known"
        if old_schema is None:
            return f"operator set {self.target_opset} has no {node.op_type}"
        if is_op(node, "GridSample") and rank_of(node.inputs[0]) != 4:
            return "GridSample took four axes before operator set 20"
        if is_op(node, *_FLATTENING_OPERATORS) and old_schema.since_version < _ONE_AXIS_OPSET:
            return f"{node.op_type} flattened before operator set {_ONE_AXIS_OPSET}"
        if is_op(node, "AveragePool") and "ceil_mode" in node.attributes:
            return "AveragePool counted padded cells differently before operator set 19"
        return (
            _argument_obstacle(node, old_schema)
            or _attribute_obstacle(node, old_schema)
            or _dtype_obstacle(node, old_schema)
        )

    def _is_lowered_elsewhere(self, node: ir.Node, old_schema: onnx.defs.OpSchema | None) -> bool:
        kinds = WriteOutNorms.kinds | WriteOutActivations.kinds
        # GroupNormalization had a scale per group before operator set 21.
        return node.op_type in kinds and (old_schema is None or is_op(node, "GroupNormalization"))

    def _writer(self, node: ir.Node) -> WriteOutNorms | WriteOutActivations:
        rewrite = WriteOutNorms() if node.op_type in WriteOutNorms.kinds else WriteOutActivations()
        rewrite.opset = self.opset
        return rewrite

    def _lower_node(self, node: ir.Node) -> None:
        new_schema, old_schema = (
            _schema(node.op_type, opset) for opset in (self.opset, self.target_opset)
        )
        if new_schema is None or (
            old_schema is not None and new_schema.since_version == old_schema.since_version
        ):
            return
        self.note(node)
        if self._is_lowered_elsewhere(node, old_schema):  # Case 3
            self._writer(node).replace(node)
            return
        assert old_schema is not None
        if is_op(node, "GridSample") and "mode" in node.attributes:  # Case 2
            mode = node.attributes["mode"].as_string()
            node.attributes["mode"] = ir.AttrString("mode", _OLD_MODE_NAMES.get(mode, mode))
        if is_op(node, *_REDUCTION_OPERATORS) and self.target_opset < 18:
            _axes_as_attribute(node)
        if is_op(node, "Split") and self.target_opset < _SPLIT_COUNT_OPSET and len(node.inputs) < 2:
            sizes = split_sizes(node) or []
            node.resize_inputs(2)
            node.replace_input_with(1, InsertionPoint(node).int64(*sizes))
            node.attributes.pop("num_outputs", None)
        for name in list(node.attributes):
            if name not in old_schema.attributes:
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


def _argument_obstacle(node: ir.Node, old_schema: onnx.defs.OpSchema) -> str:
    """Return why an operator's older version does not accept a node's inputs; empty if it does."""
    if is_op(node, *_REDUCTION_OPERATORS) and len(node.inputs) == 2:
        known = node.inputs[1] is None or constant_of(node.inputs[1]) is not None
        return "" if known else "its axes are not known before the frame"
    if is_op(node, "Split") and "num_outputs" in node.attributes:
        return "" if split_sizes(node) is not None else "the sizes of its outputs are not known"
    count = len([value for value in node.inputs if value is not None])
    return (
        f"it has {count} inputs, expected {old_schema.max_input} at most"
        if count > old_schema.max_input
        else ""
    )


def _attribute_obstacle(node: ir.Node, old_schema: onnx.defs.OpSchema) -> str:
    """Return the first attribute that an operator's older version lacks, or an empty text."""
    for name, attribute in node.attributes.items():
        has_no_effect = _NEW_ATTRIBUTES.get(name)
        is_new_attribute = name not in old_schema.attributes and name not in ("axes", "num_outputs")
        if is_new_attribute and (has_no_effect is None or not has_no_effect(attribute)):
            return f"it had no attribute {name!r}"
        new_value = _NEW_VALUES.get((node.op_type, name))
        if new_value is not None and attribute.as_string() == new_value:
            return f"its {name} could not be {new_value!r}"
    return ""


def _dtype_obstacle(node: ir.Node, old_schema: onnx.defs.OpSchema) -> str:
    """Return the first dtype that an operator's older version did not allow, or an empty text."""
    for formal_parameters, values in (
        (old_schema.inputs, node.inputs),
        (old_schema.outputs, node.outputs),
    ):
        for index, value in enumerate(values):
            if value is None or value.dtype is None or not formal_parameters:
                continue
            if value.dtype.name.startswith(_SMALL_DTYPES):
                return f"it did not take {value.dtype.name}"
            allowed = formal_parameters[min(index, len(formal_parameters) - 1)].types
            if str(value.type) and allowed and _type_name(value) not in allowed:
                return f"it did not take {_type_name(value)}"
    return ""


def _type_name(value: ir.Value) -> str:
    assert value.dtype is not None
    return f"tensor({onnx.TensorProto.DataType.Name(int(value.dtype)).lower()})"
