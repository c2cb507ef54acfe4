"""Reads the text embeddings of a prompt from a file of arrays.

Text encoders are never exported, because the prompt of an enhancer does not change.
"""

__all__ = ["Embeddings", "read_embeddings"]

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from gsgen.contract.errors import ConfigInvalid
from gsgen.reference_plugins.loading.array_archives import read_npz

# Names of the arrays in pipelines of diffusers, as results and as arguments.
_CONTEXT_NAMES = ("encoder_hidden_states", "prompt_embeds")
_POOLED_EMBEDDING_NAMES = ("text_embeds", "pooled_prompt_embeds")
_TIME_ID_NAMES = ("time_ids", "add_time_ids")


@dataclass(frozen=True, slots=True)
class Embeddings:
    """The text embeddings of a prompt."""

    context: Float[Tensor, "1 m d"] | None = None  # A vector for each token
    # a vector for the whole prompt, if the network takes one (SDXL)
    pooled: Float[Tensor, "1 p"] | None = None
    time_ids: tuple[float, ...] | None = None  # sizes of the image for SDXL, if the file has them

    def describe(self) -> str:
        """Describe the arrays of a prompt's embeddings in one line: shapes and sizes."""
        parts = [] if self.context is None else [f"{list(self.context.shape)}"]
        parts += [] if self.pooled is None else [f"pooled {list(self.pooled.shape)}"]
        parts += [] if self.time_ids is None else [f"time_ids {list(self.time_ids)}"]
        return ", ".join(parts)


def read_embeddings(path: Path, *, pooled: bool = False) -> Embeddings:
    """Read the text embeddings of a prompt from an npz file.

    Without ``pooled``, the file has one array [1, L, D] of any name. With it, arrays are told apart
    by name: ``prompt_embeds`` [1, L, D], ``pooled_prompt_embeds`` [1, P], and ``time_ids`` to
    override the image size.
    """
    arrays = {name: _require_numbers(name, array, path) for name, array in read_npz(path).items()}
    if pooled:
        return _named_embeddings(arrays, path)
    if len(arrays) != 1:
        raise ConfigInvalid(f"has {len(arrays)} arrays, expected one", where=str(path))
    (context,) = arrays.values()
    return Embeddings(torch.from_numpy(context))


def _require_numbers(name: str, array: np.ndarray, path: Path) -> Float32[np.ndarray, "..."]:
    if array.dtype.kind not in "fiu":
        message = f"{name} holds {array.dtype}, expected numbers"
        raise ConfigInvalid(message, where=str(path))
    with np.errstate(over="ignore"):  # numbers beyond float32 are rejected below
        numbers = array.astype(np.float32)
    if not np.isfinite(numbers).all():
        raise ConfigInvalid(f"{name} holds NaN or infinity", where=str(path))
    return numbers


def _named_embeddings(arrays: Mapping[str, np.ndarray], path: Path) -> Embeddings:
    """Find the two prompt embeddings of SDXL among the arrays of an npz file, by their names."""
    known_names = (*_CONTEXT_NAMES, *_POOLED_EMBEDDING_NAMES, *_TIME_ID_NAMES)
    unknown = [name for name in arrays if name not in known_names]
    matches = [
        [name for name in names if name in arrays]
        for names in (_CONTEXT_NAMES, _POOLED_EMBEDDING_NAMES)
    ]
    time_ids = [name for name in _TIME_ID_NAMES if name in arrays]
    if unknown or len(time_ids) > 1 or any(len(names) != 1 for names in matches):
        message = f"has the arrays {', '.join(arrays) or '(none)'}"
        hint = (
            "This network needs prompt_embeds [1, L, D] and pooled_prompt_embeds [1, P], and "
            "takes time_ids [1, 6]: named as in pipelines of diffusers."
        )
        raise ConfigInvalid(message, where=str(path), hint=hint)
    (context,), (pooled,) = matches
    if arrays[pooled].ndim != 2 or len(arrays[pooled]) != 1:
        message = f"{pooled} is {list(arrays[pooled].shape)}, expected [1, P]"
        raise ConfigInvalid(message, where=str(path))
    time_id_values = tuple(arrays[time_ids[0]].reshape(-1).tolist()) if time_ids else None
    return Embeddings(
        torch.from_numpy(arrays[context]), torch.from_numpy(arrays[pooled]), time_id_values
    )
