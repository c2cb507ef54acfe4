"""Last steps on an exported graph: what every runtime gets right, and the manifest inside."""

__all__ = ["finish"]

import onnx_ir as ir
from onnx_ir.passes.common import NameFixPass

from gsgen.contract.manifest import Manifest
from gsgen.contract.manifest_json import dumps
from gsgen.contract.model import MANIFEST_KEY
from gsgen.sdk.passes import EndOutputsOnCompute, MultiplyMatrices, RoundByFloor


def finish(model: ir.Model, manifest: Manifest) -> ir.Model:
    """Rewrite what runtimes get wrong and embed ``manifest``; the model given is changed."""
    NameFixPass()(
        model
    )  # the exporter may call a tensor `view` although an input is called so
    MultiplyMatrices()(model)
    RoundByFloor()(model)
    EndOutputsOnCompute()(model)
    model.metadata_props.clear()  # the exporter's notes name files of the author's machine
    for node in model.graph.all_nodes():
        node.metadata_props.clear()
    for value in (*model.graph.inputs, *model.graph.outputs):
        value.metadata_props.clear()
    model.metadata_props[MANIFEST_KEY] = dumps(manifest, indent=None)
    return model
