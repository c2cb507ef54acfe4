"""Save a graph: in one file, or with its weights beside it where one file cannot hold them."""

__all__ = ["has_external_weights", "refuse_overwriting", "save_model", "weight_bytes"]

from pathlib import Path

import onnx_ir as ir

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model import ModelFile

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


def refuse_overwriting(source: ModelFile, path: Path) -> None:
    """Refuse a place where a copy, or its weights, would take that of the source's weights.

    A model that was renamed still reads the file beside it that bears its old name.

    Raises:
        ConfigInvalid: Saving to ``path`` would spoil ``source``.
    """
    if path.resolve() == source.path.resolve():
        return
    read = {(source.path.parent / ref.location).resolve() for ref in source.external}
    made = path.resolve(), path.with_name(f"{path.name}.data").resolve()
    lost = [one.name for one in made if one in read]
    if lost:
        what = f"would replace {lost[0]}, which {source.path.name} reads"
        raise ConfigInvalid(what, where=str(path), mend="Choose another name or folder.")


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
