"""Running models in tests of passes: parsed from text, and run by ONNX Runtime unoptimised."""

import numpy as np
import onnx
import onnx_ir as ir
import onnxruntime

HEAD = '<ir_version: 8, opset_import: ["" : 18]> '


def parsed(text: str, head: str = HEAD) -> ir.Model:
    """Parse ONNX text and infer its shapes."""
    proto = onnx.shape_inference.infer_shapes(onnx.parser.parse_model(head + text))
    return ir.serde.deserialize_model(proto)


def checked(model: ir.Model) -> onnx.ModelProto:
    """Serialise a model that the checker finds sound, shapes included."""
    proto = ir.serde.serialize_model(model)
    onnx.checker.check_model(proto, full_check=True)
    return proto


def run(model: ir.Model, optimise: bool = False, **inputs: np.ndarray) -> list[np.ndarray]:
    """Check a model and run it on the CPU; return all of its outputs."""
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads = 1
    levels = onnxruntime.GraphOptimizationLevel
    level = levels.ORT_ENABLE_ALL if optimise else levels.ORT_DISABLE_ALL
    options.graph_optimization_level = level
    text = checked(model).SerializeToString()
    return onnxruntime.InferenceSession(text, options).run(None, inputs)


def operators(model: ir.Model) -> set[str]:
    """Return the operators of a model, those of its subgraphs included."""
    return {node.op_type for node in model.graph.all_nodes()}


def text_of(model: ir.Model) -> bytes:
    """Return what a model is, byte for byte; equal if nothing was touched."""
    return ir.serde.serialize_model(model).SerializeToString(deterministic=True)
