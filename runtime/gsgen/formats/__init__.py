"""Files of Gaussian splats: read and write them, with NumPy alone.

    >>> from gsgen.formats import open_splats
    >>> splats = open_splats("garden.ply")

What is wrong with a file is a ``FormatError`` that says where and what to do about it.
"""

from gsgen.formats.errors import (
    ArchiveDamaged,
    BodyMalformed,
    FileTruncated,
    FileUnreadable,
    FileUnwritable,
    FormatError,
    HeaderMalformed,
    NotRecognised,
    NotSupported,
    PropertyMissing,
    SizeExceeded,
    ValueInvalid,
)
from gsgen.formats.npz import read_npz
from gsgen.formats.open import open_splats
from gsgen.formats.ply import read_ply, write_ply
from gsgen.formats.ply_table import ply_properties, read_ply_columns
from gsgen.formats.splats import PackedRows, PointCloud, Splats

__all__ = [
    "ArchiveDamaged",
    "BodyMalformed",
    "FileTruncated",
    "FileUnreadable",
    "FileUnwritable",
    "FormatError",
    "HeaderMalformed",
    "NotRecognised",
    "NotSupported",
    "PackedRows",
    "PointCloud",
    "PropertyMissing",
    "SizeExceeded",
    "Splats",
    "ValueInvalid",
    "open_splats",
    "ply_properties",
    "read_npz",
    "read_ply",
    "read_ply_columns",
    "write_ply",
]
