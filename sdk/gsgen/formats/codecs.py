"""The table of splat file formats: name, suffixes, magic bytes, reader and writer of each.

Help texts, hints, error messages and the documentation read this table. A new format is a module
that reads it, an entry of the table, and a sample in ``tests/support/splat_files.py``.
"""

__all__ = [
    "CODECS",
    "Codec",
    "codec_named",
    "codec_of_suffix",
    "recognise_codec",
    "writable_formats",
]

import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import filter as matching
from pathlib import Path
from typing import BinaryIO, Final, final

import numpy as np
from jaxtyping import Int64

from gsgen.contract.file_kinds.names import META_FILE, STREAMED_META
from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES
from gsgen.formats.checkpoints.checkpoint import read_checkpoint
from gsgen.formats.checkpoints.torch_archive import PICKLE_MEMBER
from gsgen.formats.glb import container as glb_container
from gsgen.formats.glb.glb import is_gltf_of_splats, read_glb, write_glb
from gsgen.formats.ksplat import looks_like_ksplat, read_ksplat
from gsgen.formats.npz import read_npz
from gsgen.formats.ply.compressed_ply import compressed_order, write_compressed_ply
from gsgen.formats.ply.header import MAGIC as PLY_MAGIC
from gsgen.formats.ply.ply import read_ply, write_ply
from gsgen.formats.ply.write import PlyFrames
from gsgen.formats.shared.errors import NotSupported
from gsgen.formats.shared.files import FilePath, stream_size
from gsgen.formats.shared.npz_arrays import ZIP_MAGIC, unpacking
from gsgen.formats.shared.splats import PackedRows, PointCloud, Splats, save_splats_with
from gsgen.formats.sog.meta import looks_like_meta
from gsgen.formats.sog.sog import read_sog
from gsgen.formats.sog.write import sog_order, write_sog
from gsgen.formats.splat import looks_like_splat, read_splat, write_splat
from gsgen.formats.spz import container as spz_container
from gsgen.formats.spz.spz import read_spz, write_spz

Content = Splats | PointCloud | PackedRows
"""The content of a file of splats."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Codec:
    """One splat file format, with its reader and writer.

    Attributes:
        name: The name on a command line.
        title: The name in a sentence.
        contents: The versions and variants that are read, for the documentation.
        suffixes: The ends of file names; the first one is the usual one.
        read: Reads a file; ``drop_invalid`` drops rows that cannot be drawn.
        write: Writes splats to a file; None if the format is only read.
        frame_writer: Returns a writer of successive frames, which does not repeat what they share;
            None where each file is written anew.
        magic_prefixes: The first bytes of a file; any of them marks it.
        archive_members: Patterns of files of which a zip archive of this format holds one.
        matches_content: Recognises a file without marks by its first bytes and its size.
        keeps_flags: The flags of ``Splats`` that a file can state.
        most_degree: The highest SH degree that is written.
        order: Returns the order in which rows are written; None keeps the order in memory.
        loss: What writing rounds or drops, for the documentation.
        source: The repository on GitHub that describes the format; empty if it is gsgen's own.
    """

    name: str
    title: str
    contents: str
    suffixes: tuple[str, ...]
    read: Callable[..., Content]
    write: Callable[[FilePath, Splats], None] | None = None
    frame_writer: Callable[[], Callable[[FilePath, Splats], None]] | None = None
    magic_prefixes: tuple[bytes, ...] = ()
    archive_members: tuple[str, ...] = ()
    matches_content: Callable[[bytes, int], bool] | None = None
    keeps_flags: frozenset[str] = frozenset()
    most_degree: int = 4
    order: Callable[[Splats], Int64[np.ndarray, " n"]] | None = None
    loss: str = ""
    source: str = ""


CODECS: Final = (
    Codec(
        name="ply",
        title="PLY",
        contents="3DGS PLY, SH degree 0–4, or points with colours; text or binary of either byte "
        "order, properties by name",
        suffixes=(".ply",),
        read=read_ply,
        write=write_ply,
        frame_writer=lambda: PlyFrames().write,
        magic_prefixes=PLY_MAGIC,
        keeps_flags=frozenset({"antialiased", "color_space", "up", "origin"}),
        loss="nothing, bit for bit",
        source="graphdeco-inria/gaussian-splatting",
    ),
    Codec(
        name="compressed-ply",
        title="compressed PLY",
        contents="boxes of 256 splats in packed words",
        suffixes=(".compressed.ply",),
        read=read_ply,  # its marks are those of PLY, whose reader sees the packed words
        write=write_compressed_ply,
        keeps_flags=frozenset({"antialiased", "up"}),
        order=compressed_order,
        loss="steps within the box of 256 neighbours: positions and scales 1/2047 (y: 1/1023), "
        "colours 1/255; opacity 1/255, rotations 0.2°, harmonics 1/32 from −4 to 4; the order of "
        "the splats",
        source="playcanvas/splat-transform",
    ),
    Codec(
        name="spz",
        title="SPZ",
        contents="versions 1–4",
        suffixes=(".spz",),
        read=read_spz,
        write=write_spz,
        magic_prefixes=(spz_container.MAGIC,),
        matches_content=lambda head, _: spz_container.is_packed(head),
        keeps_flags=frozenset({"antialiased"}),
        loss="positions 1/4096 unit (coarser beyond 2048 units; float16 in version 1), scales 6 % "
        "from e⁻¹⁰ to e⁵·⁹, opacity 1/255, rotations 0.2° (up to version 2: 1°, more where w is "
        "near 0), harmonics 1/16 in degree 1 and 1/8 above, from −1 to 1",
        source="nianticlabs/spz",
    ),
    Codec(
        name="glb",
        title="GLB",
        contents="glTF binaries, and .gltf, with KHR_gaussian_splatting",
        suffixes=(".glb",),
        read=read_glb,
        write=write_glb,
        magic_prefixes=(glb_container.MAGIC,),
        matches_content=lambda head, _: is_gltf_of_splats(head),
        keeps_flags=frozenset({"color_space", "origin"}),
        loss="the last digits of scales, opacities and rotations",
        source="KhronosGroup/glTF",
    ),
    Codec(
        name="sog",
        title="SOG",
        contents="version 2 (1 is read), zipped or its `meta.json`; the finest level of a streamed SOG, `lod-meta.json`, which is written with four levels and errors",
        suffixes=(".sog", META_FILE, STREAMED_META),
        read=read_sog,
        write=write_sog,
        magic_prefixes=(ZIP_MAGIC,),
        archive_members=(META_FILE, f"*/{META_FILE}"),
        matches_content=lambda head, _: looks_like_meta(head),
        keeps_flags=frozenset({"antialiased"}),
        most_degree=3,
        order=sog_order,
        loss="positions 1/65535 of the range of sgn(x) ln(1 + |x|), scales and colours one of 256 "
        "numbers chosen for the scene, opacity 1/255, rotations 0.5°, harmonics one of up to "
        "65,536 sets chosen for the scene; the order of the splats",
        source="playcanvas/splat-transform",
    ),
    Codec(
        name="ksplat",
        title="KSPLAT",
        contents="version 0.1, compression 0–2",
        suffixes=(".ksplat",),
        read=read_ksplat,
        matches_content=looks_like_ksplat,
        source="mkkellogg/GaussianSplats3D",
    ),
    Codec(
        name="splat",
        title="SPLAT",
        contents="32 bytes a splat, without a header",
        suffixes=(".splat",),
        read=read_splat,
        write=write_splat,
        matches_content=looks_like_splat,
        most_degree=0,
        loss="all harmonics but the colour; opacity and colour 1/255, rotations 1°",
        source="antimatter15/splat",
    ),
    Codec(
        name="checkpoint",
        title="PyTorch checkpoint",
        contents="splats of gsplat (`ckpt_*.pt`), of splatfacto of nerfstudio (`step-*.ckpt`) and "
        "of the 3DGS training code (`chkpnt*.pth`)",
        suffixes=(".pt", ".pth", ".ckpt"),
        read=read_checkpoint,
        magic_prefixes=(ZIP_MAGIC,),
        archive_members=(PICKLE_MEMBER,),
        source="nerfstudio-project/gsplat",
    ),
    Codec(
        name="npz",
        title="NPZ",
        contents="packed rows of a frame, or points with colours",
        suffixes=(".npz",),
        read=read_npz,
        magic_prefixes=(ZIP_MAGIC,),
        archive_members=("*.npy",),
    ),
)
"""All formats, in the order in which a file is compared with them."""


def writable_formats() -> str:
    """Return the names of the splat file formats that can be written: ``ply, … or spz``."""
    *names, last = (codec.name for codec in CODECS if codec.write)
    return f"{', '.join(names)} or {last}"


def codec_named(name: str) -> Codec:
    """Return the splat file format called ``name``."""
    return {codec.name: codec for codec in CODECS}[name]


def codec_of_suffix(path: FilePath) -> Codec | None:
    """Return the splat file format with the longest suffix that ``path`` ends with, or None."""
    name = Path(path).name.lower()
    matches = [
        (len(suffix), codec.name)
        for codec in CODECS
        for suffix in codec.suffixes
        if name.endswith(suffix)
    ]
    return codec_named(max(matches)[1]) if matches else None


def recognise_codec(file: BinaryIO) -> Codec | None:
    """Detect the splat file format from the content of an open file; None if unknown."""
    file.seek(0)
    head = file.read(RECOGNITION_BYTES)
    matching_codecs = [codec for codec in CODECS if head.startswith(codec.magic_prefixes)]
    if head.startswith(ZIP_MAGIC):
        with unpacking("archive"), zipfile.ZipFile(file) as archive:
            members = archive.namelist()
        matching_codecs = [
            codec
            for codec in matching_codecs
            if any(matching(members, pattern) for pattern in codec.archive_members)
        ]
    if matching_codecs:
        return matching_codecs[0]
    similar_codecs = (
        codec
        for codec in CODECS
        if codec.matches_content and codec.matches_content(head, stream_size(file))
    )
    return next(similar_codecs, None)


def _write_by_suffix(path: FilePath, splats: Splats) -> None:
    codec = codec_of_suffix(path)
    if codec is None or codec.write is None:
        suffixes = ", ".join(codec.suffixes[0] for codec in CODECS if codec.write)
        raise NotSupported(
            f"no format that is written has the suffix of {Path(path).name}",
            expected=suffixes,
            path=str(path),
        )
    codec.write(path, splats)


save_splats_with(_write_by_suffix)
