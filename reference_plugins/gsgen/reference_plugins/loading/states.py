"""State dicts, read safely and checked name by name before anything is made of them."""

__all__ = ["Shape", "checked", "listed", "load_network", "load_state", "part"]

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.folder import required_file
from gsgen.reference_plugins.loading.script_archive import (
    is_script_archive,
    read_script_state,
)
from gsgen.reference_plugins.loading.tensor_files import load_tensors

# None stands for any size.
Shape = tuple[int | None, ...]

_SHOWN = 12
# What training on several GPUs, and compiling, put before every name.
_WRAPPERS = ("module.", "_orig_mod.")


def load_state(path: Path, what: str) -> dict[str, Any]:
    """Read a dict that ``torch.save`` wrote, onto the CPU, running no code of the file.

    Args:
        path: The file.
        what: What it should hold, for the error where it is missing.

    Raises:
        CheckpointInvalid: The file is missing, damaged, or holds more than tensors.
    """
    required_file(path, what)
    hint = "Wanted a file of tensors, as torch.save writes it; code in files is not run."
    state = load_tensors(path, hint)
    if not isinstance(state, dict):
        raise CheckpointInvalid(
            f"holds a {type(state).__name__}, wanted a state dict", where=str(path)
        )
    return {name: _unwrapped(value) for name, value in _unwrapped(state).items()}


def load_network(path: Path) -> dict[str, Any]:
    """Read the tensors of one network, of a TorchScript archive or of a state dict.

    Raises:
        CheckpointInvalid: The file is missing, damaged, or holds more than tensors.
    """
    if path.is_file() and is_script_archive(path):
        return dict(read_script_state(path))
    return load_state(path, "a network")


def _unwrapped(value: Any) -> Any:
    """Return a state dict as if its network had not been wrapped; anything else as it is."""
    for prefix in 2 * _WRAPPERS if isinstance(value, dict) and value else ():
        if all(str(name).startswith(prefix) for name in value):
            value = {str(name).removeprefix(prefix): one for name, one in value.items()}
    return value


def part(state: Mapping[str, Any], prefix: str) -> dict[str, Any]:
    """Return the entries below ``prefix``, without it."""
    return {
        name.removeprefix(prefix): value
        for name, value in state.items()
        if name.startswith(prefix)
    }


def checked(
    path: Path,
    state: Mapping[str, Any],
    wanted: Mapping[str, Shape],
    ignored: Iterable[str] = (),
) -> dict[str, Tensor]:
    """Return the tensors named in ``wanted`` as float32, and demand that there is nothing else.

    Args:
        path: The file, for the error.
        state: What was read from it.
        wanted: Name → shape.
        ignored: Beginnings of names that inference has no use for.

    Raises:
        CheckpointInvalid: Tensors are missing, unexpected, of another shape, or not finite; all
            of them are listed.
    """
    passed = tuple(ignored)
    extra = [
        name
        for name in state
        if name not in wanted and not (passed and name.startswith(passed))
    ]
    troubles = [f"missing: {listed(n for n in wanted if n not in state)}"]
    troubles += [f"unexpected: {listed(extra)}"]
    troubles += [
        _trouble(name, state[name], shape)
        for name, shape in wanted.items()
        if name in state
    ]
    found = [text for text in troubles if text and not text.endswith(": ")]
    if found:
        raise CheckpointInvalid(
            "; ".join(found[:_SHOWN]),
            where=str(path),
            hint="Its options in cfg_args may be those of another run.",
        )
    return {name: state[name].detach().to(torch.float32) for name in wanted}


def listed(names: Iterable[str], between: str = ", ") -> str:
    """Return names in one line: a few of them, and how many there are besides."""
    found = list(names)
    more = f"{between}and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
    return between.join(found[:_SHOWN]) + more


def _trouble(name: str, value: Any, shape: Shape) -> str:
    if not isinstance(value, Tensor):
        return f"{name} is a {type(value).__name__}, wanted a tensor"
    fits = value.ndim == len(shape) and all(
        expected in (None, seen) for expected, seen in zip(shape, value.shape, strict=True)
    )
    if not fits:
        words = ", ".join("any" if size is None else str(size) for size in shape)
        return f"{name} is {list(value.shape)}, wanted [{words}]"
    if not torch.isfinite(value.to(torch.float32)).all():
        return f"{name} holds NaN or infinity"
    return ""
