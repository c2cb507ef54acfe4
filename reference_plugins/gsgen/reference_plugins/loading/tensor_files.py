"""Reads files that ``torch.save`` wrote, without running code that a pickle names."""

__all__ = ["PlaceholderObject", "load_tensors"]

import pickle
import struct
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from gsgen.reference_plugins.loading.errors import CheckpointInvalid, reason_of

# Training computes learning rates and scene sizes with NumPy, and saves them with the tensors.
# They are not used here.
_NUMPY_NAMES = (
    "numpy.dtype",
    "numpy.ndarray",
    *(
        f"numpy.{core_name}.multiarray.{name}"
        for core_name in ("core", "_core")
        for name in ("scalar", "_reconstruct")
    ),
)

# Errors of reading a file that torch did not write.
_DAMAGE_ERRORS = (
    pickle.UnpicklingError, struct.error, AttributeError, EOFError, LookupError, OSError,
    RuntimeError, TypeError, ValueError,
)  # fmt: skip


class PlaceholderObject:
    """Placeholder for a class that a pickle names: keeps the object's state and runs no code."""

    def __init__(self, *_: Any) -> None:
        self.given_state: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        self.given_state = state if isinstance(state, dict) else {}


def load_tensors(path: Path, hint: str, known: Sequence[tuple[type, str]] = ()) -> Any:
    """Return the object that ``torch.save`` wrote, with its tensors on the CPU.

    ``known`` pairs a class with the name of a class in the file that it replaces.
    """
    inert_types: list[Any] = [*((PlaceholderObject, name) for name in _NUMPY_NAMES), *known]
    try:
        with torch.serialization.safe_globals(inert_types), warnings.catch_warnings():
            # torch warns of other protocols of pickle than its own, and reads them.
            warnings.simplefilter("ignore")
            return torch.load(path, map_location="cpu", weights_only=True)
    except _DAMAGE_ERRORS as error:
        message = f"cannot be read: {reason_of(error)}"
        raise CheckpointInvalid(message, where=str(path), hint=hint) from error
