"""Optimises a graph as torch's exporter does, in a time that grows with the number of its nodes.

The exporter's own optimiser has one rule more, which joins two slices into one split. It compares
each node with all others, so that a graph of ten thousand nodes takes minutes.
"""

__all__ = ["optimize"]

import onnx_ir as ir
from onnx_ir.passes import common as graph_passes
from onnxscript.optimizer import fold_constants_ir
from onnxscript.rewriter import RewritePass
from onnxscript.rewriter.rules import common as rules

_RULES = (
    # Operators that leave their input as it is.
    *(rules.sub_0_rule, rules.div_by_1_rule, rules.no_op_cast_rule, rules.no_op_expand_rule),
    *(rules.no_op_transpose_rule, rules.dropout_zero_rule, rules.dropout_inference_rule),
    *(rules.no_op_static_scatter_nd_rule, rules.no_op_dynamic_scatter_nd_rule),
    # Two operators in a row that are one.
    *(rules.cast_cast_rule, rules.collapse_slice_rule, rules.collapse_slice2_rule),
    *(rules.reshape_reshape_rule, rules.transpose_transpose_rule, rules.unsqueeze_unsqueeze_rule),
    *(rules.min_min_rule, rules.max_max_rule, rules.min_max_rule, rules.max_min_rule),
    *(rules.successive_clip_relu_rule, rules.successive_clip_rule),
    *(rules.successive_relu_clip_rule, rules.successive_relu_rule),
    # Shapes that are known.
    *(rules.cast_constant_of_shape_rule, rules.cast_constant_of_shape_without_value_rule),
    *(rules.flatten_to_reshape_rule, rules.squeeze_reshape_1d_rule),
    *(rules.materialize_reshape_shape_rule,),
    *(rules.one_reshape_matmul_reshape_rule, rules.two_reshapes_matmul_reshape_rule),
    # Convolutions and matrix products with what surrounds them.
    *(rules.fuse_batchnorm_into_conv_rule, rules.fuse_batchnorm_into_conv_transpose_rule),
    *(rules.fuse_batchnorm_into_gemm_rule, rules.fuse_pad_into_conv_rule),
    *(rules.fuse_pad_into_conv_integer_rule, rules.normalize_pad_format_conv_rule),
    *(rules.normalize_pad_format_conv_integer_rule, rules.remove_optional_bias_from_conv_rule),
    *(
        rules.remove_optional_bias_from_conv_transpose_rule,
        rules.remove_optional_bias_from_gemm_rule,
    ),
    *(rules.remove_optional_bias_from_qlinear_conv_rule,),
)
_OPTIMIZER_ROUNDS = 2


def optimize(model: ir.Model) -> None:
    """Fold constants, merge operators and remove unused ones, in place."""
    graph_passes.InlinePass()(model)
    for _ in range(_OPTIMIZER_ROUNDS):
        constant_folding = fold_constants_ir(model)
        rewritten = RewritePass(_RULES)(model)
        graph_passes.RemoveUnusedNodesPass()(model)
        graph_passes.RemoveUnusedFunctionsPass()(model)  # type: ignore[no-untyped-call]
        if not (constant_folding.modified or rewritten.modified):
            break
    ir.passes.Sequential(
        graph_passes.RemoveUnusedOpsetsPass(),
        graph_passes.LiftConstantsToInitializersPass(lift_all_constants=True, size_limit=0),
        graph_passes.LiftSubgraphInitializersToMainGraphPass(),
        graph_passes.DeduplicateInitializersPass(),
        graph_passes.CommonSubexpressionEliminationPass(),
        graph_passes.OutputFixPass(),
        graph_passes.NameFixPass(),
    )(model)
