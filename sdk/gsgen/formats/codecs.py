"""The formats: what each is called, how it is told from the others, and who reads and writes it."""

import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final, final

import numpy as np
from jaxtyping import Int64

from gsgen.formats.glb.glb import read_glb, write_glb
from gsgen.formats.ksplat import looks_like_ksplat, read_ksplat
from gsgen.formats.npz import read_npz
from gsgen.formats.ply.compressed_ply import compressed_order, write_compressed_ply
from gsgen.formats.ply.ply import read_ply, write_ply
from gsgen.formats.shared.bytes import Data
from gsgen.formats.shared.files import FilePath
from gsgen.formats.shared.npz_arrays import unpacking
from gsgen.formats.shared.splats import PackedRows, PointCloud, Splats
from gsgen.formats.sog.meta import META
from gsgen.formats.sog.sog import read_sog
from gsgen.formats.splat import looks_like_splat, read_splat, write_splat
from gsgen.formats.spz.spz import read_spz, write_spz

__all__ = ["CODECS", "Codec", "codec_named", "codec_of_suffix", "recognised"]

Content = Splats | PointCloud | PackedRows
"""What a file can hold."""


@final
@dataclass(frozen=True, slots=True)
class Codec:
    """One format.

    Attributes:
        name: What to call it on a command line.
        title: What people call it.
        suffixes: How names of its files end.
        read: Reads a file.
        write: Writes splats to a file; None where that is not done here.
        keeps_flags: Whether files say that splats are antialiased, and of linear colour.
        most_degree: The highest SH degree that is written.
        order: The order in which rows are written; None for that in memory.
    """

    name: str
    title: str
    suffixes: tuple[str, ...]
    read: Callable[[FilePath], Content]
    write: Callable[[FilePath, Splats], None] | None = None
    keeps_flags: frozenset[str] = frozenset()
    most_degree: int = 4
    order: Callable[[Splats], Int64[np.ndarray, " n"]] | None = None


CODECS: Final = (
    Codec("ply", "3DGS PLY", (".ply",), read_ply, write_ply),
    Codec(
        "compressed-ply",
        "compressed PLY",
        (".compressed.ply",),
        read_ply,
        write_compressed_ply,
        order=compressed_order,
    ),
    Codec("splat", "SPLAT", (".splat",), read_splat, write_splat, most_degree=0),
    Codec("spz", "SPZ", (".spz",), read_spz, write_spz, frozenset({"antialiased"})),
    Codec(
        "glb",
        "GLB, KHR_gaussian_splatting",
        (".glb",),
        read_glb,
        write_glb,
        frozenset({"color_space"}),
    ),
    Codec("ksplat", "KSPLAT", (".ksplat",), read_ksplat),
    Codec("sog", "SOG", (".sog", META), read_sog),
    Codec("npz", "packed rows or points in an NPZ archive", (".npz",), read_npz),
)
"""All formats."""


def codec_named(name: str) -> Codec:
    """Return the format ``name``.

    Raises:
        KeyError: There is none.
    """
    return {codec.name: codec for codec in CODECS}[name]


def codec_of_suffix(path: FilePath) -> Codec | None:
    """Return the format that the longest suffix of ``path`` names, or None."""
    name = Path(path).name.lower()
    found = [
        (len(suffix), codec.name)
        for codec in CODECS
        for suffix in codec.suffixes
        if name.endswith(suffix)
    ]
    return codec_named(max(found)[1]) if found else None


def recognised(path: FilePath, data: Data) -> Codec | None:
    """Return the format whose marks ``data`` bears, or None.

    Args:
        path: Where ``data`` is from; archives are looked into through it.
        data: The bytes of the file.

    Raises:
        ArchiveDamaged: It is a zip archive that cannot be listed.
    """
    first = bytes(data[:6])
    for marks, name in _MARKS:
        if first.startswith(marks):
            return codec_named(name)
    if first.startswith(b"PK\x03\x04"):
        with unpacking("archive"), zipfile.ZipFile(path) as archive:
            return codec_named("sog" if META in archive.namelist() else "npz")
    if looks_like_ksplat(data):
        return codec_named("ksplat")
    return codec_named("splat") if looks_like_splat(data) else None


_MARKS: Iterable[tuple[tuple[bytes, ...], str]] = (
    ((b"ply\n", b"ply\r\n"), "ply"),
    ((b"\x1f\x8b", b"NGSP"), "spz"),
    ((b"glTF",), "glb"),
    ((b'{"', b"{\n", b"{ ", b"{\r", b"{\t"), "sog"),
)
