"""Last steps on an exported graph: the rewrites that every runtime needs, and the manifest inside."""

__all__ = ["finish"]

import onnx_ir as ir
from onnx_ir.passes.common import NameFixPass

from gsgen.contract.model.model_file import MANIFEST_KEY
from gsgen.contract.spec.manifest import Manifest
from gsgen.contract.spec.manifest_io import dumps
from gsgen.contract.spec.targets import Target
from gsgen.sdk.passes.framework.base import RewriteTarget, opset_of
from gsgen.sdk.rewriting.rewrite import Change, rewrite_graph


def finish(
    model: ir.Model, manifest: Manifest, target: Target, *, rewrite: bool = True
) -> list[Change]:
    """Rewrite ``model`` for ``target``, and embed ``manifest``; say what was rewritten.

    Args:
        model: An exported graph; it is changed.
        manifest: What it is.
        target: The consumer; ``core`` means all that are known.
        rewrite: Whether to rewrite; without, the graph stays as torch wrote it.
    """
    NameFixPass()(
        model
    )  # the exporter may call a tensor `view` although an input is called so
    # The operator set is the one that was asked for when the graph was made.
    goal = RewriteTarget.of(target, manifest, opset_of(model))
    changes = rewrite_graph(model, goal) if rewrite else []
    model.metadata_props.clear()  # the exporter's notes name files of the author's machine
    for node in model.graph.all_nodes():
        node.metadata_props.clear()
    for value in (*model.graph.inputs, *model.graph.outputs):
        value.metadata_props.clear()
    model.metadata_props[MANIFEST_KEY] = dumps(manifest, indent=None)
    return changes
