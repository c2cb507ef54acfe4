"""Reads and writes files of Gaussian splats, such as PLY and SPZ, with NumPy.

Two formats need another package: SOG needs Pillow, version 4 of SPZ needs zstandard.

    >>> from gsgen.formats import open_splats
    >>> splats = open_splats("garden.ply")

A fault of a file raises a ``FormatError`` with the location, the expected value and a hint.
"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names
from gsgen.formats.checkpoints.checkpoint import read_checkpoint
from gsgen.formats.codecs import CODECS, Codec, codec_named, codec_of_suffix
from gsgen.formats.glb.glb import read_glb, write_glb
from gsgen.formats.ksplat import read_ksplat
from gsgen.formats.npz import read_npz
from gsgen.formats.open import open_splats
from gsgen.formats.packed import splats_of_rows
from gsgen.formats.ply.compressed_ply import compressed_order, write_compressed_ply
from gsgen.formats.ply.ply import read_ply, write_ply
from gsgen.formats.ply.table import ply_properties, read_ply_columns
from gsgen.formats.shared.errors import (
    ArchiveDamaged,
    BodyMalformed,
    FileTruncated,
    FileUnreadable,
    FileUnwritable,
    FormatError,
    FormatNotRecognised,
    HeaderMalformed,
    NotSupported,
    PropertyMissing,
    SizeExceeded,
    ValueInvalid,
)
from gsgen.formats.shared.notices import FormatWarning
from gsgen.formats.shared.splats import PackedRows, PointCloud, Splats
from gsgen.formats.sog.sog import read_sog
from gsgen.formats.sog.write import write_sog
from gsgen.formats.splat import read_splat, write_splat
from gsgen.formats.spz.spz import read_spz, write_spz

if TYPE_CHECKING:
    from gsgen.formats.conversion import Conversion, convert
    from gsgen.formats.loss import Difference, differences

__all__ = [
    "CODECS",
    "ArchiveDamaged",
    "BodyMalformed",
    "Codec",
    "Conversion",
    "Difference",
    "FileTruncated",
    "FileUnreadable",
    "FileUnwritable",
    "FormatError",
    "FormatNotRecognised",
    "FormatWarning",
    "HeaderMalformed",
    "NotSupported",
    "PackedRows",
    "PointCloud",
    "PropertyMissing",
    "SizeExceeded",
    "Splats",
    "ValueInvalid",
    "codec_named",
    "codec_of_suffix",
    "compressed_order",
    "convert",
    "differences",
    "open_splats",
    "ply_properties",
    "read_checkpoint",
    "read_glb",
    "read_ksplat",
    "read_npz",
    "read_ply",
    "read_ply_columns",
    "read_sog",
    "read_splat",
    "read_spz",
    "splats_of_rows",
    "write_compressed_ply",
    "write_glb",
    "write_ply",
    "write_sog",
    "write_splat",
    "write_spz",
]

# What only conversions need: public name → module.
_MODULE_BY_NAME: Final = {
    "Conversion": "gsgen.formats.conversion",
    "convert": "gsgen.formats.conversion",
    "Difference": "gsgen.formats.loss",
    "differences": "gsgen.formats.loss",
}

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)
