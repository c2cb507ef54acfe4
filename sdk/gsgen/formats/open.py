"""Opens a splat file of any supported format."""

__all__ = ["open_splats"]

from typing import Protocol

from gsgen.contract._entry_points import registered_entry_points
from gsgen.formats.codecs import codec_of_suffix, format_titles, recognised
from gsgen.formats.ply.ply import read_ply
from gsgen.formats.shared.bytes import contents
from gsgen.formats.shared.errors import NotRecognised
from gsgen.formats.shared.files import FilePath
from gsgen.formats.shared.splats import PackedRows, PointCloud, Splats


class SplatReader(Protocol):
    """Plug-in that reads splats of many files (entry point group ``gsgen.splat_readers``)."""

    def recognises(self, path: FilePath) -> bool:
        """Return whether ``path`` names a set of files that this plug-in reads."""
        ...

    def read_leaves(self, source: FilePath) -> Splats:
        """Return all splats of a tiled file set at the finest level of detail."""
        ...


def find_tiled_reader(path: FilePath) -> SplatReader | None:
    """Return the plug-in that reads ``path`` as a set of files, such as a tileset."""
    for point in registered_entry_points("gsgen.splat_readers"):
        reader: SplatReader = point.load()
        if reader.recognises(path):
            return reader
    return None


def open_splats(path: FilePath, *, drop_invalid: bool = False) -> Splats | PointCloud | PackedRows:
    """Read a splat file of any supported format, detected from its content.

    ``CODECS`` lists the formats. SPLAT has no header: it is a number of plausible records that
    no other format recognises. If no format fits, the suffix chooses the reader that explains
    the fault. A tileset (tileset.json, .3tz, or the address of one) gives all its leaves.

    Args:
        path: The file.
        drop_invalid: Drop rows of a PLY file that cannot be drawn, and warn about them
            (FormatWarning); see :func:`read_ply`.

    Returns:
        ``Splats``; or ``PointCloud`` where a PLY or NPZ file holds points, or
        ``PackedRows`` where an NPZ archive does.

    Raises:
        FormatError: The file cannot be read; the subclass names the cause.
        InputUnreadable: A file of the tileset is missing or invalid.
    """
    tiled_reader = find_tiled_reader(path)
    if tiled_reader is not None:
        return tiled_reader.read_leaves(path)
    with contents(path) as data:
        codec, first = recognised(path, data), bytes(data[:5])
    codec = codec or codec_of_suffix(path)
    if codec is None:
        raise NotRecognised(
            first.hex(" "),
            where="first bytes",
            expected=f"a file of splats: {format_titles()}",
            hint="if it is of another format, convert it to one of these first",
            path=str(path),
        )
    if drop_invalid and codec.name == "ply":
        return read_ply(path, drop_invalid=True)
    return codec.read(path)
