"""Rewrite a traced graph for its target runtime, and embed the manifest."""

__all__ = ["rewrite_and_embed", "with_profile"]

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import onnx_ir as ir
from onnx_ir.passes.common import NameFixPass

from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.spec.manifest import Manifest
from gsgen.contract.spec.manifest_io import dumps
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN
from gsgen.contract.spec.reader_needs import smallest_profile
from gsgen.contract.spec.targets import Target
from gsgen.sdk.passes.framework.base import RewriteTarget, opset_of
from gsgen.sdk.rewriting.rewrite import Change, rewrite_graph

AnyManifest = TypeVar("AnyManifest", bound=Manifest)


def rewrite_and_embed(
    model: ir.Model,
    manifest: Manifest,
    target: Target,
    *,
    rewrite: bool = True,
    skip: Sequence[str] = (),
) -> list[Change]:
    """Rewrite a model for a target runtime, embed the manifest, and return the rewrites.

    Without ``rewrite``, the graph stays as torch exported it; ``skip`` are names of passes.
    """
    # The exporter may call a tensor `view` although an input has that name.
    NameFixPass()(model)
    # The graph was traced at the requested operator set, so the passes keep it.
    rewrite_target = RewriteTarget.of(target, manifest, opset_of(model))
    changes = rewrite_graph(model, rewrite_target, skip=skip) if rewrite else []
    # The exporter's metadata names files of the author's machine, and takes room.
    nodes = list(model.graph.all_nodes())
    values = [value for node in nodes for value in node.outputs]
    values += [*model.graph.inputs, *model.graph.initializers.values()]
    notes = [model.metadata_props, model.graph.metadata_props]
    notes += [node.metadata_props for node in nodes] + [value.metadata_props for value in values]
    for metadata in notes:
        metadata.clear()
    model.metadata_props[MANIFEST_KEY] = dumps(with_profile(manifest, model), indent=None)
    return changes


def with_profile(manifest: AnyManifest, model: ir.Model) -> AnyManifest:
    """Return the manifest with the operator profile that covers the graph's operators, if any."""
    names = {node.op_type for node in model.graph.all_nodes()}
    has_main_domains = all(node.domain in MAIN_DOMAIN for node in model.graph.all_nodes())
    profile = smallest_profile(names, opset_of(model)) if has_main_domains else None
    return replace(manifest, operator_profile=profile)
