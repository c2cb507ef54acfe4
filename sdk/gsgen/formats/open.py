"""Open a file of splats, whatever its format."""

from gsgen.formats.codecs import codec_of_suffix, recognised
from gsgen.formats.ply.ply import read_ply
from gsgen.formats.shared.bytes import contents
from gsgen.formats.shared.errors import NotRecognised
from gsgen.formats.shared.files import FilePath
from gsgen.formats.shared.splats import PackedRows, PointCloud, Splats

__all__ = ["open_splats"]


def open_splats(
    path: FilePath, *, drop_invalid: bool = False
) -> Splats | PointCloud | PackedRows:
    """Read the file at ``path``, whose format its content tells and not its name.

    It is a PLY file (plain or compressed), SPZ, GLB, SOG (an archive or its meta.json),
    KSPLAT, SPLAT or NPZ. SPLAT has no header: it is what else is a number of plausible
    records. Only if nothing fits, the name says which reader explains what is wrong.

    Args:
        path: The file.
        drop_invalid: Leave out rows of a PLY file that cannot be drawn, and warn of them
            (FormatWarning); see :func:`read_ply`.

    Returns:
        ``Splats``; or ``PointCloud`` where a PLY or NPZ file holds points, or
        ``PackedRows`` where an NPZ archive does.

    Raises:
        FormatError: The file cannot be read; the subclass says what happened.
    """
    with contents(path) as data:
        codec, first = recognised(path, data), bytes(data[:5])
    codec = codec or codec_of_suffix(path)
    if codec is None:
        raise NotRecognised(
            first.hex(" "),
            where="first bytes",
            expected="a file of splats: PLY, SPZ, GLB, SOG, KSPLAT, SPLAT or NPZ",
            hint="if it is of another format, convert it to one of these first",
            path=str(path),
        )
    if drop_invalid and codec.name == "ply":
        return read_ply(path, drop_invalid=True)
    return codec.read(path)
