"""Opens a splat file of any supported format."""

__all__ = ["open_splats", "require_codec"]

from dataclasses import replace

from gsgen.contract.file_kinds.names import SPLAT_FORMATS
from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES, kind_of
from gsgen.formats.codecs import Codec, codec_of_suffix, recognise_codec
from gsgen.formats.inputs import TRAINING_HINT, resolve_input, training_folder
from gsgen.formats.shared.errors import FormatError, FormatNotRecognised, NotSupported
from gsgen.formats.shared.files import FilePath, open_file
from gsgen.formats.shared.notices import warn_unused
from gsgen.formats.shared.origins import Origin, with_origin
from gsgen.formats.shared.splats import PackedRows, PointCloud, Splats
from gsgen.formats.shared.suspicions import warn_of_suspicions
from gsgen.formats.tileset_paths import names_tileset


def open_splats(
    path: FilePath, *, drop_invalid: bool = False, origin: Origin | None = None
) -> Splats | PointCloud | PackedRows:
    """Read a splat file of any supported format, detected from its content.

    ``CODECS`` lists the formats. SPLAT has no header: it is a number of plausible records that
    no other format recognises. If no format fits, the suffix chooses the reader that explains
    the fault. ``gsgen.tiles.open_splats`` also reads tilesets.

    Args:
        path: The file, or its address: ``https://``, ``hf://OWNER/NAME/FILE``, ``s3://``, ….
        drop_invalid: Drop rows that cannot be drawn, and warn about them (FormatWarning); see
            :func:`read_ply`.
        origin: The point of the file that positions become relative to; None for 0, or for a point
            that float32 needs to keep the digits of coordinates such as those of maps.

    Returns:
        ``Splats``; or ``PointCloud`` where a PLY or NPZ file holds points, or
        ``PackedRows`` where an NPZ archive does.

    Raises:
        FormatError: The file cannot be read; the subclass names the cause.
        InputUnreadable: The file at an address cannot be had.
    """
    if names_tileset(path):
        raise NotSupported(
            "names a tileset",
            where="path",
            expected="one file of splats",
            hint="gsgen.tiles.open_splats reads tilesets",
            path=str(path),
        )
    run = training_folder(path)
    file = resolve_input(path)
    codec = require_codec(file)
    try:
        content = with_origin(codec.read(file, drop_invalid=drop_invalid), origin, path)
    except FormatError as error:
        if run is not None and not error.hint:
            error.hint = TRAINING_HINT
        raise
    if run is not None:
        warn_unused(path, [f"file {name}" for name in run.unused])
    if isinstance(content, Splats):
        warn_of_suspicions(content, file)
    if run is not None and run.antialiased and isinstance(content, Splats):
        return replace(content, antialiased=True)
    return content


def require_codec(file: FilePath) -> Codec:
    """Return the splat file format of a file, by its content, or by its suffix if it is unknown.

    Raises:
        FormatNotRecognised: The content is of another kind, which the error names.
    """
    with open_file(file) as stream:
        codec = recognise_codec(stream)
        stream.seek(0)
        head = stream.read(RECOGNITION_BYTES)
        if codec is not None:
            return codec
        codec, kind = codec_of_suffix(file), kind_of(head, stream)
        # The reader explains the fault of a file of unknown content.
        if codec is not None and (kind is None or kind.name == "zeros"):
            return codec
        expected = f"a file of splats: {SPLAT_FORMATS}"
        if kind is not None:
            raise FormatNotRecognised(f"this is {kind.title}", expected=expected, hint=kind.hint)
        raise FormatNotRecognised(
            head[:5].hex(" "),
            where="first bytes",
            expected=expected,
            hint="If it is of another format, convert it to one of these first.",
        )
