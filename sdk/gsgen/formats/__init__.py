"""Reads and writes files of Gaussian splats, such as PLY and SPZ, with NumPy.

Two formats need another package: SOG needs Pillow, version 4 of SPZ needs zstandard.

    >>> from gsgen.formats import open_splats
    >>> splats = open_splats("garden.ply")

A fault of a file raises a ``FormatError`` with the location, the expected value and a hint.
"""

from typing import TYPE_CHECKING, Final

from gsgen import _lazy_names

if TYPE_CHECKING:
    from gsgen.formats.checkpoints.checkpoint import read_checkpoint
    from gsgen.formats.codecs import CODECS, Codec, codec_named, codec_of_suffix
    from gsgen.formats.conversion import Conversion, convert
    from gsgen.formats.glb.glb import read_glb, write_glb
    from gsgen.formats.ksplat import read_ksplat
    from gsgen.formats.loss import Difference, differences
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

# Public name → module, which is imported when the name is used.
_MODULE_BY_NAME: Final = {
    "CODECS": "gsgen.formats.codecs",
    "ArchiveDamaged": "gsgen.formats.shared.errors",
    "BodyMalformed": "gsgen.formats.shared.errors",
    "Codec": "gsgen.formats.codecs",
    "Conversion": "gsgen.formats.conversion",
    "Difference": "gsgen.formats.loss",
    "FileTruncated": "gsgen.formats.shared.errors",
    "FileUnreadable": "gsgen.formats.shared.errors",
    "FileUnwritable": "gsgen.formats.shared.errors",
    "FormatError": "gsgen.formats.shared.errors",
    "FormatNotRecognised": "gsgen.formats.shared.errors",
    "FormatWarning": "gsgen.formats.shared.notices",
    "HeaderMalformed": "gsgen.formats.shared.errors",
    "NotSupported": "gsgen.formats.shared.errors",
    "PackedRows": "gsgen.formats.shared.splats",
    "PointCloud": "gsgen.formats.shared.splats",
    "PropertyMissing": "gsgen.formats.shared.errors",
    "SizeExceeded": "gsgen.formats.shared.errors",
    "Splats": "gsgen.formats.shared.splats",
    "ValueInvalid": "gsgen.formats.shared.errors",
    "codec_named": "gsgen.formats.codecs",
    "codec_of_suffix": "gsgen.formats.codecs",
    "compressed_order": "gsgen.formats.ply.compressed_ply",
    "convert": "gsgen.formats.conversion",
    "differences": "gsgen.formats.loss",
    "open_splats": "gsgen.formats.open",
    "ply_properties": "gsgen.formats.ply.table",
    "read_checkpoint": "gsgen.formats.checkpoints.checkpoint",
    "read_glb": "gsgen.formats.glb.glb",
    "read_ksplat": "gsgen.formats.ksplat",
    "read_npz": "gsgen.formats.npz",
    "read_ply": "gsgen.formats.ply.ply",
    "read_ply_columns": "gsgen.formats.ply.table",
    "read_sog": "gsgen.formats.sog.sog",
    "read_splat": "gsgen.formats.splat",
    "read_spz": "gsgen.formats.spz.spz",
    "splats_of_rows": "gsgen.formats.packed",
    "write_compressed_ply": "gsgen.formats.ply.compressed_ply",
    "write_glb": "gsgen.formats.glb.glb",
    "write_ply": "gsgen.formats.ply.ply",
    "write_sog": "gsgen.formats.sog.write",
    "write_splat": "gsgen.formats.splat",
    "write_spz": "gsgen.formats.spz.spz",
}

__getattr__, __dir__ = _lazy_names(__name__, _MODULE_BY_NAME)
