"""Loads an ONNX graph, and saves it in one file or with external weights beyond protobuf's limit."""

__all__ = ["has_external_weights", "load_model", "refuse_overwriting", "save_model", "weight_bytes"]

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import onnx_ir as ir

from gsgen.contract.errors import ConfigInvalid, ModelUnreadable
from gsgen.contract.model.files_beside import FileRefused, find_contained_file, require_loadable
from gsgen.contract.model.model_file import ModelFile
from gsgen.contract.spec.onnx_facts import INLINE_LIMIT

# Weights up to this size stay in the model even if larger ones go to a second file.
_MAX_INLINE_WEIGHT_BYTES = 256


def load_model(path: Path) -> ir.Model:
    """Load a model file, whose external weights are mapped when they are used.

    Raises:
        ModelUnreadable: The file is not an ONNX model, or external weights are outside its folder,
            missing or too short.
    """
    source = require_loadable(path)
    try:
        model = ir.load(source, format="protobuf")
        weight_bytes(model)  # raises if a weight has no size, as of an undefined dtype
    except Exception as error:  # onnx-ir's errors share no base class
        message = f"the file is not a readable ONNX graph: {error}"
        raise ModelUnreadable(message, where=str(path)) from error
    for value in _weights(model):
        if isinstance(value.const_value, ir.ExternalTensor):
            value.const_value = _resolve_weight_path(source, value.const_value)
    return model


def _resolve_weight_path(model: Path, tensor: ir.ExternalTensor) -> ir.ExternalTensor:
    """Return an external weight without links in its path, which onnx-ir follows in a folder only."""
    path = find_contained_file(model, os.fspath(tensor.location))
    return ir.ExternalTensor(
        path.name,
        tensor.offset,
        tensor.length,
        tensor.dtype,
        shape=tensor.shape,
        name=tensor.name,
        doc_string=tensor.doc_string,
        metadata_props=dict(tensor.metadata_props),
        base_dir=path.parent,
    )


def weight_bytes(model: ir.Model) -> int:
    """Return the size in bytes of all weights of a model, including those of subgraphs."""
    return sum(_sizes(model))


def has_external_weights(model: ir.Model) -> bool:
    """Return whether a model stores a weight in another file."""
    return any(isinstance(value.const_value, ir.ExternalTensor) for value in _weights(model))


def _weights(model: ir.Model) -> Iterator[ir.Value]:
    for graph in model.graphs():
        yield from graph.initializers.values()


def _sizes(model: ir.Model) -> list[int]:
    tensors = (value.const_value for value in _weights(model))
    return [tensor.nbytes for tensor in tensors if tensor is not None]


def refuse_overwriting(source: ModelFile, path: Path) -> None:
    """Raise if saving a copy of a model would overwrite the external weights of the source.

    A renamed model still reads the weight file with its old name.
    """
    if path.resolve() == source.path.resolve():
        return
    read = set(_weight_files(source))
    written_paths = path.resolve(), path.with_name(f"{path.name}.data").resolve()
    overwritten_names = [target.name for target in written_paths if target in read]
    if overwritten_names:
        message = f"would replace {overwritten_names[0]}, which {source.path.name} reads"
        raise ConfigInvalid(message, where=str(path), hint="Choose another name or folder.")


def _weight_files(source: ModelFile) -> Iterator[Path]:
    """Yield the files of a model's external weights that may be read; others cannot be saved."""
    for ref in source.external:
        with suppress(FileRefused):
            yield find_contained_file(source.loading_path, ref.location)


def save_model(model: ir.Model, path: Path, *, external_weights: bool = False) -> None:
    """Write a model file, with external weights where protobuf's size limit requires them.

    ``model`` stays unchanged. ``external_weights`` stores large weights in a second file, ``path``
    with the suffix ``.data``, even if they fit the model file.
    """
    sizes = _sizes(model)
    if (external_weights and max(sizes, default=0) > _MAX_INLINE_WEIGHT_BYTES) or sum(
        sizes
    ) > INLINE_LIMIT:
        name = f"{path.name}.data"
        ir.save(model, path, external_data=name, size_threshold_bytes=_MAX_INLINE_WEIGHT_BYTES)
        return
    with _weights_in_memory(model):
        ir.save(model, path)


@contextmanager
def _weights_in_memory(model: ir.Model) -> Iterator[None]:
    """Load external weights into memory during the ``with`` block."""
    external_weights_list = [
        v for v in _weights(model) if isinstance(v.const_value, ir.ExternalTensor)
    ]
    tensors = [value.const_value for value in external_weights_list]
    ir.external_data.load_to_model(model)
    try:
        yield
    finally:
        for value, tensor in zip(external_weights_list, tensors, strict=True):
            value.const_value = tensor
