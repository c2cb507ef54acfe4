"""Save a graph: in one file, or with its weights beside it where one file cannot hold them."""

__all__ = ["has_external_weights", "refuse_overwriting", "save_model", "weight_bytes"]

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import onnx_ir as ir

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.model.model_file import ModelFile

# A protobuf message ends at 2 GiB; weights beyond this go to a file beside the model.
_INLINE_BYTES = 1_900_000_000
# Weights up to this size stay in the model even where others go beside it.
_SMALL_BYTES = 256


def weight_bytes(model: ir.Model) -> int:
    """Return the size of all weights, those of subgraphs included."""
    return sum(_sizes(model))


def has_external_weights(model: ir.Model) -> bool:
    """Say whether a weight lies in another file than the model."""
    return any(
        isinstance(value.const_value, ir.ExternalTensor) for value in _weights(model)
    )


def _weights(model: ir.Model) -> Iterator[ir.Value]:
    for graph in model.graphs():
        yield from graph.initializers.values()


def _sizes(model: ir.Model) -> list[int]:
    held = (value.const_value for value in _weights(model))
    return [tensor.nbytes for tensor in held if tensor is not None]


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
        raise ConfigInvalid(what, where=str(path), hint="Choose another name or folder.")


def save_model(model: ir.Model, path: Path, *, beside: bool = False) -> None:
    """Write ``model`` to ``path``.

    Args:
        model: What to write; it is left as it is.
        path: Where to.
        beside: Weights go to ``path`` with ``.data`` behind it, even if they fit the file; there
            is no such file where all are small.
    """
    sizes = _sizes(model)
    if (beside and max(sizes, default=0) > _SMALL_BYTES) or sum(sizes) > _INLINE_BYTES:
        name = f"{path.name}.data"
        ir.save(model, path, external_data=name, size_threshold_bytes=_SMALL_BYTES)
        return
    with _weights_in_memory(model):
        ir.save(model, path)


@contextmanager
def _weights_in_memory(model: ir.Model) -> Iterator[None]:
    """Hold the numbers of weights in other files, and forget them in the end."""
    lying = [v for v in _weights(model) if isinstance(v.const_value, ir.ExternalTensor)]
    tensors = [value.const_value for value in lying]
    ir.external_data.load_to_model(model)
    try:
        yield
    finally:
        for value, tensor in zip(lying, tensors, strict=True):
            value.const_value = tensor
