"""Where a generator's weights came from, for its manifest."""

__all__ = ["producer_of"]

import hashlib
from importlib.metadata import version
from pathlib import Path

from gsgen.contract.spec.manifest import Producer

_WEIGHTS = (".ply", ".pt", ".pth")
_PLACES = ("point_cloud", "deform", "mlp_ckpt")


def producer_of(source: str, folder: Path, iteration: int) -> Producer:
    """Return who made a model from a checkpoint.

    Args:
        source: Where the method's code is.
        folder: What training wrote, or an iteration of it by itself.
        iteration: Which one was read.

    The digest is that of the contents of all PLY and torch files of the iteration, one after
    another in the order of their paths.
    """
    places = [folder / place / f"iteration_{iteration}" for place in _PLACES]
    places = places if places[0].is_dir() else [folder]
    files = [
        file for place in places for file in place.glob("*") if file.suffix in _WEIGHTS
    ]
    digest = hashlib.sha256()
    for file in sorted(files):
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return Producer(f"gsgen {version('gsgen')}", source, weights_sha256=digest.hexdigest())
