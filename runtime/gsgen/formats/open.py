"""Open a file of splats, whatever its format."""

from gsgen.formats._files import FilePath, opened
from gsgen.formats.errors import NotRecognised
from gsgen.formats.npz import read_npz
from gsgen.formats.ply import read_ply
from gsgen.formats.splats import PackedRows, PointCloud, Splats

__all__ = ["open_splats"]


def open_splats(path: FilePath) -> Splats | PointCloud | PackedRows:
    """Read the file at ``path``, whose format its first bytes tell and not its name.

    Returns:
        ``Splats`` or ``PointCloud`` of a PLY file, ``PackedRows`` or ``PointCloud`` of
        an NPZ archive; see ``read_ply`` and ``read_npz``.

    Raises:
        FormatError: The file cannot be read; the subclass says what happened.
    """
    with opened(path) as file:
        first = file.read(5)
        if first.startswith(b"PK\x03\x04"):
            return read_npz(path)
        if first.startswith((b"ply\n", b"ply\r\n")):
            return read_ply(path)
        raise NotRecognised(
            first.hex(" "),
            where="first bytes",
            expected="70 6c 79 0a (a PLY file) or 50 4b 03 04 (an NPZ archive)",
            mend="convert it first, for example with `splat-transform scene.spz scene.ply`",
        )
