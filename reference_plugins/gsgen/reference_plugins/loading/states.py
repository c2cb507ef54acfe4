"""Reads state dicts without running code, and checks the shape of every tensor.

The training code of Scaffold-GS saves its networks as TorchScript (``torch.jit.save``), whose code
can do anything. The archive also holds a pickle of the modules' attributes, from which the tensors
are read by their names in ``state_dict``.
"""

__all__ = [
    "Layer", "Shape", "entries_below", "first_names", "is_script_archive", "layer_of",
    "linear_shapes", "load_network", "load_state", "read_script_state", "require_tensors",
]  # fmt: skip

import zipfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from gsgen.formats.checkpoints.pickled_data import OpaqueObject, TensorReference
from gsgen.formats.checkpoints.torch_archive import TorchArchive
from gsgen.formats.shared.errors import FormatError
from gsgen.formats.shared.npz_arrays import unpacking
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.tensor_files import load_tensors

Shape = tuple[int | None, ...]
"""Sizes of a tensor's axes; None allows any size."""
Layer = tuple[Float[Tensor, "o i"], Float[Tensor, " o"]]
"""Weight and bias of a dense layer."""

_MAX_SHOWN_KEYS = 12
# Prefixes of every name after training on several GPUs, and after compilation.
_MODULE_WRAPPER_PREFIXES = ("module.", "_orig_mod.")


def load_state(path: Path, content: str) -> dict[str, Any]:
    """Read a dict that ``torch.save`` wrote, without running code of the file.

    ``content`` describes the file in the error if it is missing.
    """
    required_file(path, content)
    hint = "Expected a file of tensors, as torch.save writes it; code in files is not run."
    state = load_tensors(path, hint)
    if not isinstance(state, dict):
        message = f"holds a {type(state).__name__}, expected a state dict"
        raise CheckpointInvalid(message, where=str(path))
    return {name: _strip_prefixes(value) for name, value in _strip_prefixes(state).items()}


def load_network(path: Path) -> dict[str, Any]:
    """Read the tensors of one network, of a TorchScript archive or of a state dict."""
    if path.is_file() and is_script_archive(path):
        return read_script_state(path)
    return load_state(path, "a network")


def _strip_prefixes(value: Any) -> Any:
    """Remove wrapper prefixes from the names in a state dict; return any other object unchanged."""
    for prefix in 2 * _MODULE_WRAPPER_PREFIXES if isinstance(value, dict) and value else ():
        if all(str(name).startswith(prefix) for name in value):
            value = {str(name).removeprefix(prefix): entry for name, entry in value.items()}
    return value


def entries_below(state: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    """Return the dict entries whose names start with a prefix, without that prefix."""
    return {
        name.removeprefix(prefix): value for name, value in state.items() if name.startswith(prefix)
    }


def require_tensors(
    path: Path, state: Mapping[str, Any], expected: Mapping[str, Shape], ignored: Iterable[str] = ()
) -> dict[str, Tensor]:
    """Return the expected tensors as float32; raise if any is missing, invalid or unexpected.

    ``ignored`` are prefixes of names that inference does not use; the message lists all faults.
    """
    ignored_prefixes = tuple(ignored)
    unknown_names = [
        name
        for name in state
        if name not in expected and not (ignored_prefixes and name.startswith(ignored_prefixes))
    ]
    tensor_problems = [f"missing: {first_names(n for n in expected if n not in state)}"]
    tensor_problems += [f"unexpected: {first_names(unknown_names)}"]
    tensor_problems += [
        _tensor_problem(name, state[name], shape)
        for name, shape in expected.items()
        if name in state
    ]
    problems = [text for text in tensor_problems if text and not text.endswith(": ")]
    if problems:
        hint = "Its cfg_args may come from another training run."
        raise CheckpointInvalid("; ".join(problems[:_MAX_SHOWN_KEYS]), where=str(path), hint=hint)
    return {name: state[name].detach().to(torch.float32) for name in expected}


def linear_shapes(name: str, inputs: int | None, outputs: int | None) -> dict[str, Shape]:
    """Return the expected shapes of the weight and the bias of a dense layer."""
    return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}


def layer_of(state: Mapping[str, Tensor], name: str) -> Layer:
    """Return weight and bias of a dense layer in a state dict."""
    return state[f"{name}.weight"], state[f"{name}.bias"]


def first_names(names: Iterable[str], separator: str = ", ") -> str:
    """Join the first few names of a list, and append the number of the others."""
    listed_names = list(names)
    remainder = (
        f"{separator}and {len(listed_names) - _MAX_SHOWN_KEYS} more"
        if len(listed_names) > _MAX_SHOWN_KEYS
        else ""
    )
    return separator.join(listed_names[:_MAX_SHOWN_KEYS]) + remainder


def _tensor_problem(name: str, value: Any, shape: Shape) -> str:
    if not isinstance(value, Tensor):
        return f"{name} is a {type(value).__name__}, expected a tensor"
    has_fitting_shape = value.ndim == len(shape) and all(
        expected in (None, actual) for expected, actual in zip(shape, value.shape, strict=True)
    )
    if not has_fitting_shape:
        words = ", ".join("any" if size is None else str(size) for size in shape)
        return f"{name} is {list(value.shape)}, expected [{words}]"
    if not torch.isfinite(value.to(torch.float32)).all():
        return f"{name} holds NaN or infinity"
    return ""


def is_script_archive(path: Path) -> bool:
    """Return whether ``torch.jit.save``, and not ``torch.save``, wrote a file.

    True for an archive too damaged to be listed: :func:`read_script_state` then refuses it.
    """
    try:
        if not zipfile.is_zipfile(path):
            return False
        with zipfile.ZipFile(path) as archive:
            return any(name.endswith("/constants.pkl") for name in archive.namelist())
    except (zipfile.BadZipFile, ValueError, RuntimeError, OSError):
        return True


def read_script_state(path: Path) -> dict[str, Tensor]:
    """Return the parameters and buffers of a TorchScript archive by dotted name, as float32.

    The archive may refer to tensors and modules only.
    """
    try:
        with unpacking("TorchScript"), zipfile.ZipFile(path) as file:
            archive = TorchArchive(file, path.stat().st_size)
            read: dict[TensorReference, Tensor] = {}
            state: dict[str, Tensor] = {}
            for name, tensor in _tensors(archive.data(), "", set()):
                if tensor not in read:  # one tensor may have several names
                    read[tensor] = torch.from_numpy(archive.array(tensor, name))
                state[name] = read[tensor]
            return state
    except FormatError as error:
        hint = "Expected a network saved by torch.jit.save, as the training code writes it."
        raise CheckpointInvalid(f"cannot be read: {error}", where=str(path), hint=hint) from error


def _tensors(value: Any, prefix: str, seen_ids: set[int]) -> Iterator[tuple[str, TensorReference]]:
    """Yield the tensors of a module and of the modules in it, by their dotted names."""
    if isinstance(value, TensorReference):
        yield prefix, value
    elif isinstance(value, OpaqueObject):
        if not value.name.startswith("__torch__."):
            raise ValueError(f"the pickle refers to {value.name}, which is not a tensor")
        if (
            id(value) in seen_ids
        ):  # modules that share modules may have more names than can be listed
            raise ValueError("a module of the pickle is part of two others, expected a tree")
        if not isinstance(value.state, dict):
            raise ValueError(f"the module {value.name} of the pickle has no attributes")
        seen_ids.add(id(value))
        for name, child in value.state.items():
            yield from _tensors(child, f"{prefix}.{name}" if prefix else str(name), seen_ids)
