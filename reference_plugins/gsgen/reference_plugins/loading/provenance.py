"""Records the source and the checksum of a generator model's weights for its manifest."""

__all__ = ["producer_of", "producer_of_weights"]

import hashlib
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from gsgen.contract.spec.manifest import Producer
from gsgen.formats.codecs import codec_named
from gsgen.reference_plugins.loading.training_run import TrainingRun

_WEIGHT_SUFFIXES = (*codec_named("ply").suffixes, *codec_named("checkpoint").suffixes)
_PARENT_FOLDERS = ("point_cloud", "deform", "mlp_ckpt")


def producer_of(source: str, run: TrainingRun, weights: Sequence[Path] = ()) -> Producer:
    """Return the producer entry of the manifest: version, source and checksum of the weights.

    The digest is that of the contents of ``weights``, or else of all PLY and torch files of the
    iteration, one after another in the order of their paths.
    """
    folders = [run.folder / parent / f"iteration_{run.iteration}" for parent in _PARENT_FOLDERS]
    folders = folders if folders[0].is_dir() else [run.folder]
    files = [
        file
        for iteration_folder in folders
        for file in iteration_folder.glob("*")
        if file.suffix in _WEIGHT_SUFFIXES
    ]
    return producer_of_weights(source, weights or files)


def producer_of_weights(source: str | None, weights: Sequence[Path]) -> Producer:
    """Return the producer entry of the manifest for the files that hold all weights."""
    digest = hashlib.sha256()
    for file in sorted(weights):
        with file.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return Producer(f"gsgen {version('gsgen')}", source, weights_sha256=digest.hexdigest())
