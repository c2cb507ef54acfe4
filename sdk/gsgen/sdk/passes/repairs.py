"""Repairs of model outputs that violate a rule, where only one repair is possible."""

__all__ = [
    "CastCountOutput", "PadColor", "PinDimensions", "RenameOutputs", "ReorderHarmonics", "SilencePadding",
]  # fmt: skip

from abc import abstractmethod
from collections.abc import Mapping

import numpy as np
import onnx_ir as ir
from onnx_ir import passes

from gsgen.contract.errors import GsgenError
from gsgen.sdk.passes.framework.graph_builder import append_output, new_node, unused_name, weight
from gsgen.sdk.passes.framework.value_facts import numpy_dtype

_RGB_CHANNEL_COUNT = 3


class _Repair(passes.InPlacePass):
    def call(self, model: ir.Model) -> passes.PassResult:
        return passes.PassResult(model, modified=self.repair(model))

    @abstractmethod
    def repair(self, model: ir.Model) -> bool: ...


class _OutputRepair(_Repair):
    def __init__(self, name: str) -> None:
        super().__init__()
        self.name = name


class CastCountOutput(_OutputRepair):
    """Cast the row count output to int32 [1], because runtimes read four bytes (rule GO011).

    ::

        num_points int64 []   →   Reshape([1]) → Cast(int32) → num_points
    """

    def repair(self, model: ir.Model) -> bool:
        """Reshape the row count to [1], then cast to int32: graph capture supports this order."""
        graph, count = model.graph, _output(model, self.name)
        flat = count.shape is not None and list(count.shape) == [1]
        if flat and count.dtype == ir.DataType.INT32:
            return False
        vector_shape = weight(graph, f"{self.name}_one", np.array([1]))
        reshaped_count = new_node(
            "Reshape", [count, vector_shape], f"{self.name}_flat", dtype=count.dtype
        )
        cast_operation = new_node(
            "Cast",
            [reshaped_count.outputs[0]],
            f"{self.name}_int32",
            dtype=ir.DataType.INT32,
            shape=[1],
            to=ir.DataType.INT32.value,
        )
        append_output(graph, count, [reshaped_count, cast_operation])
        return True


class PadColor(_OutputRepair):
    """Pad float16 RGB to four channels with ones, so that rows fill whole words (rule GO015).

    ::

        color_rgb [N, 3]   →   Concat(color_rgb, 1) → color_rgb [N, 4]
    """

    def repair(self, model: ir.Model) -> bool:
        """Append a column of ones to the colour output of a float16 model."""
        graph, color = model.graph, _output(model, self.name)
        if color.shape is None or len(color.shape) != 2 or color.shape[1] != _RGB_CHANNEL_COUNT:
            return False
        rows = color.shape[0]
        if not isinstance(rows, int) or color.dtype != ir.DataType.FLOAT16:
            return False
        # One number, expanded when the model is loaded: a whole column would be stored.
        unit = weight(graph, f"{self.name}_one", np.ones((1, 1), np.float16))
        size = weight(graph, f"{self.name}_rows", np.array([rows, 1], np.int64))
        column = new_node(
            "Expand", [unit, size], f"{self.name}_ones", dtype=ir.DataType.FLOAT16, shape=[rows, 1]
        )
        concat_operation = new_node(
            "Concat",
            [color, column.outputs[0]],
            f"{self.name}_padded",
            dtype=color.dtype,
            shape=[rows, _RGB_CHANNEL_COUNT + 1],
            axis=1,
        )
        append_output(graph, color, [column, concat_operation])
        return True


class SilencePadding(_Repair):
    """Set every value of the padding rows after the row count to zero (rules GV002 and GV018).

    Where selects, so a NaN after the count is removed; a product would keep it::

        gaussians   →   Where(arange < num_points, gaussians, 0) → gaussians
    """

    def __init__(self, names: tuple[str, ...], count: str) -> None:
        super().__init__()
        self.names = names
        self.count = count

    def repair(self, model: ir.Model) -> bool:
        """Set each output to zero from row index ``count`` on, by a mask over row indices."""
        graph, count = model.graph, _output(model, self.count)
        outputs = [_output(model, name) for name in self.names]
        rows = outputs[0].shape[0] if outputs[0].shape is not None else None
        if not isinstance(rows, int):
            return False
        row_numbers = weight(graph, "row_numbers", np.arange(rows, dtype=np.int32)[:, None])
        live = new_node(
            "Less", [row_numbers, count], "live_rows", dtype=ir.DataType.BOOL, shape=[rows, 1]
        )
        graph.append(live)
        for value in outputs:
            zero = weight(graph, f"{value.name}_zero", np.zeros((), numpy_dtype(value)))
            masked_value = new_node("Where", [live.outputs[0], value, zero], f"{value.name}_live")
            masked_value.outputs[0].type, masked_value.outputs[0].shape = value.type, value.shape
            append_output(graph, value, [masked_value])
        return True


class RenameOutputs(_Repair):
    """Rename outputs and list them first, for viewers that find them by name (TV101 and TV102)."""

    def __init__(self, names: Mapping[str, str]) -> None:
        super().__init__()
        self.names = names

    def repair(self, model: ir.Model) -> bool:
        """Rename outputs and list them first; an inner value that has a new name is renamed, too."""
        renames = {old: new for old, new in self.names.items() if old != new}
        graph = model.graph
        ends = {*graph.inputs, *(v for v in graph.outputs if v.name not in renames)}
        used_names = {value.name for value in ends}
        for old, new in renames.items():
            if new in used_names:
                message = f"already exists, so output {old!r} cannot be renamed to it"
                raise GsgenError(message, where=new)
        inner_values = [value for node in graph for value in node.outputs]
        for value in (*inner_values, *graph.initializers.values()):
            if value.name in renames.values() and value not in graph.outputs:
                value.name = unused_name(graph, f"{value.name}_inner")
        for value in model.graph.outputs:
            value.name = renames.get(value.name or "", value.name)
        new_names = list(self.names.values())
        order = sorted(
            graph.outputs,
            key=lambda v: new_names.index(v.name) if v.name in new_names else len(new_names),
        )
        is_modified = bool(renames) or order != list(graph.outputs)
        graph.outputs[:] = order
        return is_modified


class PinDimensions(_Repair):
    """Give symbolic dimensions of model inputs and outputs a fixed size (rule GO004)."""

    def __init__(self, sizes: Mapping[str, int]) -> None:
        super().__init__()
        self.sizes = sizes

    def repair(self, model: ir.Model) -> bool:
        """Replace every symbolic dimension for which the user passed a size."""
        is_modified = False
        for value in (*model.graph.inputs, *model.graph.outputs):
            if value.shape is None:
                continue
            dims = [self._size(dim) for dim in value.shape]
            if dims != list(value.shape):
                value.shape = ir.Shape(dims)
                is_modified = True
        return is_modified

    def _size(self, dim: int | ir.SymbolicDim) -> int | ir.SymbolicDim:
        symbol = None if isinstance(dim, int) else dim.value
        return self.sizes.get(str(symbol), dim) if symbol is not None else dim


def _output(model: ir.Model, name: str) -> ir.Value:
    return next(value for value in model.graph.outputs if value.name == name)


class ReorderHarmonics(_OutputRepair):
    """Reorder SH from channel-major (R… G… B…) to coefficient-major (RGB RGB …), only if requested.

    ::

        color_sh [R… G… B…]   →   Gather(axis=1) → color_sh [RGB RGB …]
    """

    def repair(self, model: ir.Model) -> bool:
        """Gather the columns of the SH output in coefficient-major order."""
        graph, color = model.graph, _output(model, self.name)
        size = color.shape[1] if color.shape is not None and len(color.shape) == 2 else None
        if not isinstance(size, int) or size % _RGB_CHANNEL_COUNT:
            return False
        slots = np.arange(size).reshape(_RGB_CHANNEL_COUNT, -1).T.reshape(-1)
        order = weight(graph, f"{self.name}_order", slots)
        gather_operation = new_node("Gather", [color, order], f"{self.name}_reordered", axis=1)
        gather_operation.outputs[0].type, gather_operation.outputs[0].shape = (
            color.type,
            color.shape,
        )
        append_output(graph, color, [gather_operation])
        return True
