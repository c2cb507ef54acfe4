"""Save a graph: in one file, or with its weights beside it where one file cannot hold them."""

__all__ = ["has_external_weights", "save_model", "weight_bytes"]

from pathlib import Path

import onnx_ir as ir

# A protobuf message ends at 2 GiB; weights beyond this go to a file beside the model.
_INLINE_BYTES = 1_900_000_000


def weight_bytes(model: ir.Model) -> int:
    """Return the size of all weights of the main graph."""
    values = model.graph.initializers.values()
    return sum(v.const_value.nbytes for v in values if v.const_value is not None)


def has_external_weights(model: ir.Model) -> bool:
    """Say whether a weight lies in another file than the model."""
    return any(
        isinstance(value.const_value, ir.ExternalTensor)
        for graph in model.graphs()
        for value in graph.initializers.values()
    )


def save_model(model: ir.Model, path: Path, *, beside: bool = False) -> None:
    """Write ``model`` to ``path``.

    Args:
        model: What to write; it is left as it is.
        path: Where to.
        beside: Weights go to ``path`` with ``.data`` behind it, even if they fit the file.
    """
    if beside or weight_bytes(model) > _INLINE_BYTES:
        ir.save(model, path, external_data=f"{path.name}.data")
        return
    if has_external_weights(model):
        ir.external_data.load_to_model(model)
    ir.save(model, path)
