"""Exports of one test run share torch's tables of operators.

Torch parses the source of all its operators anew for each export, half a second each time, and
looks fifty times through those that it composes of others, a seventh of a second. It makes one
annotation of a function for each of them, a thirtieth of a second, and registers eleven thousand
kernels of them for the while, a tenth of a second. It reads the schema of an ONNX operator for each
node, a thirtieth of an export. Its optimiser tries 46 rules at each node, a twelfth of an export,
and for some of them lists all nodes of the graph, seconds in a graph of two thousand.
"""

__all__ = ["share_operators"]

from collections.abc import Callable
from functools import cache
from typing import Any

import pytest


def share_operators(patch: pytest.MonkeyPatch) -> None:
    """Let torch make its tables of operators once, and copy them from then on."""
    _share_registry(patch)
    _share_composite_operators(patch)
    _share_annotations(patch)
    _register_kernels_quickly(patch)
    _share_signatures(patch)
    _try_rules_that_may_match(patch)


def _share_registry(patch: pytest.MonkeyPatch) -> None:
    """Make the table of translations once for each operator set."""
    from torch.onnx._internal.exporter._registration import ONNXRegistry

    make: Callable[..., Any] = ONNXRegistry.from_torchlib
    made = cache(make)

    def from_torchlib(*options: Any, **named: Any) -> Any:
        kept, copied = made(*options, **named), ONNXRegistry()
        vars(copied).update(vars(kept))
        copied.functions = {target: list(known) for target, known in kept.functions.items()}
        return copied

    patch.setattr(ONNXRegistry, "from_torchlib", staticmethod(from_torchlib))


def _share_composite_operators(patch: pytest.MonkeyPatch) -> None:
    """Collect the composite operators again only after one was registered."""
    import torch
    from torch._export import utils
    from torch.export import decomp_utils, exported_program

    collect = utils._collect_all_valid_cia_ops
    collected: dict[tuple[str, ...], set[Any]] = {}

    def collect_once() -> set[Any]:
        key = "CompositeImplicitAutograd"
        registered = (*torch.ops._dir, *torch._C._dispatch_get_registrations_for_dispatch_key(key))
        if registered not in collected:
            collected[registered] = collect()
        return set(collected[registered])

    for module in (utils, decomp_utils, exported_program):
        patch.setattr(module, "_collect_all_valid_cia_ops", collect_once)


def _share_annotations(patch: pytest.MonkeyPatch) -> None:
    """Make an annotation of a function inside of a method once, instead of at every call."""
    import torch

    class Annotations:
        __getitem__ = staticmethod(cache(lambda types: Callable[*types]))

        def __instancecheck__(self, value: object) -> bool:
            return callable(value)

    patch.setattr(torch._ops, "Callable", Annotations())


def _register_kernels_quickly(patch: pytest.MonkeyPatch) -> None:
    """Compare the key of a kernel with those of the operator alone, not with special ones, too."""
    from torch._C import DispatchKey
    from torch._ops import OperatorBase

    py_impl: Callable[..., Any] = OperatorBase.py_impl

    def register_for(operator: Any, key: Any) -> Any:
        if type(key) is not DispatchKey or key in operator.py_kernels:
            return py_impl(operator, key)  # refuses the latter

        def register(kernel: Any) -> Any:
            operator.py_kernels[key] = kernel
            operator._dispatch_cache.clear()
            return kernel

        return register

    patch.setattr(OperatorBase, "py_impl", register_for)


def _share_signatures(patch: pytest.MonkeyPatch) -> None:
    """Read the schema of an ONNX operator once."""
    from onnx_ir.schemas import OpSignature

    read: Callable[[Any], OpSignature] = OpSignature.from_op_schema
    signatures: dict[tuple[str, str, int], OpSignature] = {}

    def from_op_schema(schema: Any) -> OpSignature:
        key = schema.domain, schema.name, schema.since_version
        if key not in signatures:
            signatures[key] = read(schema)
        return signatures[key]

    patch.setattr(OpSignature, "from_op_schema", staticmethod(from_op_schema))


def _try_rules_that_may_match(patch: pytest.MonkeyPatch) -> None:
    """Try a rule only at nodes with the operator of its pattern's first output.

    The matcher looks at the operator itself, after it has listed the whole graph for a pattern of
    several outputs, and tells in words why any other does not match.
    """
    from onnxscript.rewriter._rewrite_rule import RewriteRule

    try_rewrite: Callable[..., Any] = RewriteRule.try_rewrite

    @cache
    def operator_of(rule: Any) -> tuple[str, ...] | None:
        first: tuple[str, ...] | None = rule._target_pattern.output_nodes[0].op_identifier()
        return first and first[:2]

    def try_likely(rule: Any, model: Any, graph: Any, node: Any, **options: Any) -> Any:
        operator = operator_of(rule)
        if operator is not None and operator != (node.domain, node.op_type):
            return None
        return try_rewrite(rule, model, graph, node, **options)

    patch.setattr(RewriteRule, "try_rewrite", try_likely)
