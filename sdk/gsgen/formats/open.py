"""Opens a splat file of any supported format."""

__all__ = ["open_splats"]

from gsgen.formats.codecs import codec_of_suffix, format_titles, recognise_codec
from gsgen.formats.ply.ply import read_ply
from gsgen.formats.shared.bytes import contents
from gsgen.formats.shared.errors import NotRecognised, NotSupported
from gsgen.formats.shared.files import FilePath
from gsgen.formats.shared.splats import PackedRows, PointCloud, Splats
from gsgen.formats.tileset_paths import names_tileset


def open_splats(path: FilePath, *, drop_invalid: bool = False) -> Splats | PointCloud | PackedRows:
    """Read a splat file of any supported format, detected from its content.

    ``CODECS`` lists the formats. SPLAT has no header: it is a number of plausible records that
    no other format recognises. If no format fits, the suffix chooses the reader that explains
    the fault. ``gsgen.tiles.open_splats`` also reads tilesets and addresses.

    Args:
        path: The file.
        drop_invalid: Drop rows of a PLY file that cannot be drawn, and warn about them
            (FormatWarning); see :func:`read_ply`.

    Returns:
        ``Splats``; or ``PointCloud`` where a PLY or NPZ file holds points, or
        ``PackedRows`` where an NPZ archive does.

    Raises:
        FormatError: The file cannot be read; the subclass names the cause.
    """
    if names_tileset(path):
        raise NotSupported(
            "names a tileset",
            where="path",
            expected="one file of splats",
            hint="gsgen.tiles.open_splats reads tilesets",
            path=str(path),
        )
    with contents(path) as data:
        codec, first = recognise_codec(path, data), bytes(data[:5])
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
