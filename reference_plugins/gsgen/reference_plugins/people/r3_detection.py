"""Distinguishes runs of R3-Avatar from those of GauHuman, whose files have the same names."""

__all__ = ["is_r3_run"]

import zipfile
from pathlib import Path

# A module of R3-Avatar's training code, whose classes are in its checkpoints.
_DECODER_MODULE = b"gaussian_decoder"
_MAX_PICKLE_BYTES = 1 << 26


def is_r3_run(run: Path) -> bool:
    """Return whether a training run is of R3-Avatar, by ``chkpntN.pth``, without unpickling."""
    return any(_is_r3_checkpoint(path) for path in sorted(run.glob("chkpnt*.pth")))


def _is_r3_checkpoint(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            for entry in archive.infolist():
                if entry.filename.endswith("/data.pkl") and entry.file_size < _MAX_PICKLE_BYTES:
                    return _DECODER_MODULE in archive.read(entry)
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError):
        return False  # the reader of the file reports the error
    return False
