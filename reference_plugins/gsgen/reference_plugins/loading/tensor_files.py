"""Files that ``torch.save`` wrote, read without running any code of theirs."""

__all__ = ["Inert", "load_tensors"]

import pickle
import struct
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from gsgen.reference_plugins.loading.reasons import reason_of

# Training computes learning rates and sizes of scenes with NumPy, and its numbers get saved beside
# tensors. None of them is needed.
_NUMPY = (
    "numpy.dtype",
    "numpy.ndarray",
    *(
        f"numpy.{core}.multiarray.{name}"
        for core in ("core", "_core")
        for name in ("scalar", "_reconstruct")
    ),
)

# What the reader stumbles over in a file that is none of torch's.
_DAMAGED = (
    pickle.UnpicklingError,
    struct.error,
    AttributeError,
    EOFError,
    LookupError,
    OSError,
    RuntimeError,
    TypeError,
    ValueError,
)


class Inert:
    """Stands for what a file names and nobody needs: keeps its state and does nothing."""

    def __init__(self, *_: Any) -> None:
        self.given: dict[str, Any] = {}

    def __setstate__(self, state: Any) -> None:
        self.given = state if isinstance(state, dict) else {}


def load_tensors(path: Path, hint: str, known: Sequence[tuple[type, str]] = ()) -> Any:
    """Return what ``path`` holds, its tensors on the CPU whatever machine they were on.

    Args:
        path: The file.
        hint: What is wanted, for the error of a file that holds something else.
        known: Classes to put in the place of those that the file names.

    Raises:
        CheckpointInvalid: The file is damaged, or names code.
    """
    inert: list[Any] = [*((Inert, name) for name in _NUMPY), *known]
    try:
        with torch.serialization.safe_globals(inert), warnings.catch_warnings():
            # torch warns of other protocols of pickle than its own, and reads them.
            warnings.simplefilter("ignore")
            return torch.load(path, map_location="cpu", weights_only=True)
    except _DAMAGED as error:
        what = f"cannot be read: {reason_of(error)}"
        raise CheckpointInvalid(what, where=str(path), hint=hint) from error
