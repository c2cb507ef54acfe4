"""What text encoders make of a prompt, as a file of arrays.

The text encoders themselves are never exported: the prompt of an enhancer does not change.
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

# What pipelines of diffusers call the arrays, as results and as arguments.
_CONTEXT = ("encoder_hidden_states", "prompt_embeds")
_POOLED = ("text_embeds", "pooled_prompt_embeds")
_TIME_IDS = ("time_ids", "add_time_ids")


@dataclass(frozen=True, slots=True)
class Embeddings:
    """A prompt, encoded.

    Attributes:
        context: A vector for each of its tokens.
        pooled: One for all of it, where the network asks for that (SDXL).
        time_ids: Sizes of the image that is asked for, if the file says them.
    """

    context: Float[Tensor, "1 m d"] | None = None
    pooled: Float[Tensor, "1 p"] | None = None
    time_ids: tuple[float, ...] | None = None

    def describe(self) -> str:
        """Say the arrays' shapes."""
        parts = [] if self.context is None else [f"{list(self.context.shape)}"]
        parts += [] if self.pooled is None else [f"pooled {list(self.pooled.shape)}"]
        parts += [] if self.time_ids is None else [f"time_ids {list(self.time_ids)}"]
        return ", ".join(parts)


def read_embeddings(path: Path, *, pooled: bool = False) -> Embeddings:
    """Read an npz file.

    Args:
        path: With one array, [1, L, D], of any name.
        pooled: It has more, and their names say which is which: ``prompt_embeds`` [1, L, D],
            ``pooled_prompt_embeds`` [1, P], and ``time_ids`` if the image is to be of another
            size than it is.

    Raises:
        CheckpointInvalid: The file cannot be read as npz.
        ConfigInvalid: It lacks an array, or has one of another kind.
    """
    found = {name: _numbers(name, one, path) for name, one in read_npz(path).items()}
    if pooled:
        return _sorted(found, path)
    if len(found) != 1:
        raise ConfigInvalid(f"has {len(found)} arrays, wanted one", where=str(path))
    (context,) = found.values()
    return Embeddings(torch.from_numpy(context))


def _numbers(name: str, array: np.ndarray, path: Path) -> Float32[np.ndarray, "..."]:
    if array.dtype.kind not in "fiu":
        what = f"{name} holds {array.dtype}, wanted numbers"
        raise ConfigInvalid(what, where=str(path))
    with np.errstate(over="ignore"):  # what float32 cannot hold is refused with the rest
        made = array.astype(np.float32)
    if not np.isfinite(made).all():
        raise ConfigInvalid(f"holds NaN or infinity: {name}", where=str(path))
    return made


def _sorted(found: Mapping[str, np.ndarray], path: Path) -> Embeddings:
    """Tell the arrays apart by their names."""
    known = (*_CONTEXT, *_POOLED, *_TIME_IDS)
    unknown = [name for name in found if name not in known]
    taken = [[name for name in names if name in found] for names in (_CONTEXT, _POOLED)]
    time_ids = [name for name in _TIME_IDS if name in found]
    if unknown or len(time_ids) > 1 or any(len(names) != 1 for names in taken):
        what = f"has the arrays {', '.join(found) or 'none'}"
        hint = (
            "This network wants prompt_embeds [1, L, D] and pooled_prompt_embeds [1, P], and "
            "takes time_ids [1, 6]: names as in pipelines of diffusers."
        )
        raise ConfigInvalid(what, where=str(path), hint=hint)
    (context,), (pooled,) = taken
    if found[pooled].ndim != 2 or len(found[pooled]) != 1:
        what = f"{pooled} is {list(found[pooled].shape)}, wanted [1, P]"
        raise ConfigInvalid(what, where=str(path))
    told = tuple(found[time_ids[0]].reshape(-1).tolist()) if time_ids else None
    return Embeddings(
        torch.from_numpy(found[context]), torch.from_numpy(found[pooled]), told
    )
