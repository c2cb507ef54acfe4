"""Parses the header of a PLY file: elements, property types, and the offset of the data.

The format is that of Greg Turk, "The PLY Polygon File Format", 1994, with the sized
type names (``float32``) that later writers added.
"""

import math
import mmap
import re
from dataclasses import dataclass
from typing import Final, Literal, final, get_args

from gsgen.formats.shared.bytes import not_recognised
from gsgen.formats.shared.errors import FileTruncated, HeaderMalformed, quoted

Encoding = Literal["ascii", "binary_little_endian", "binary_big_endian"]
"""The encodings of the rows of a PLY file."""

MAGIC: Final = (b"ply\n", b"ply\r\n")
"""The first line of a PLY file, with either line end."""

PLY_ENCODINGS: Final[tuple[Encoding, ...]] = get_args(Encoding)
COLOR_SPACE: Final = "color_space"
"""The element, and its property, in which SHARP declares the colour space; 1 is linear."""
ANTIALIASED_COMMENT: Final = "comment SplatRenderMode: mip"
"""The header line of antialiased splats, in the words of Brush."""
_VERTICAL_AXIS = re.compile(r"(?:vertical|up)[ _]axis\s*[:=]?\s*(.*)", re.IGNORECASE)
_AXES: Final = {
    "x": (1.0, 0.0, 0.0), "+x": (1.0, 0.0, 0.0), "-x": (-1.0, 0.0, 0.0),
    "y": (0.0, -1.0, 0.0), "+y": (0.0, 1.0, 0.0), "-y": (0.0, -1.0, 0.0),
    "z": (0.0, 0.0, 1.0), "+z": (0.0, 0.0, 1.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip
_RENDER_MODE = re.compile(r"SplatRenderMode:\s*(\S+)|antialiased\s+(\d+)", re.IGNORECASE)
MAX_HEADER = 1 << 20
"""The largest header that is read, in bytes; a splat file needs about 2000."""
MAX_COUNT_DIGITS = 18
"""The most digits of an element count; more rows would not fit on any disk."""

PROPERTY_TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
"""The NumPy kind and size in bytes of every scalar type of PLY."""


@final
@dataclass(frozen=True, slots=True)
class Property:
    """A PLY property: one value per row, or a list of values if ``count_type`` is set."""

    name: str
    type: str
    count_type: str | None = None

    @property
    def size(self) -> int:
        """The size in bytes of one value of the PLY property."""
        return int(self.type[1])


@final
@dataclass(frozen=True, slots=True)
class Element:
    """A PLY element: a table of ``count`` rows with the same properties."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def has_lists(self) -> bool:
        """Whether a property of the PLY element is a list, so that row sizes differ."""
        return any(item.count_type for item in self.properties)

    @property
    def row_bytes(self) -> int:
        """The size in bytes of one binary row of a PLY element without lists."""
        return sum(item.size for item in self.properties)

    @property
    def types(self) -> dict[str, str]:
        """The type of each property of the PLY element, by name."""
        return {item.name: item.type for item in self.properties}


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Header:
    """A PLY header: the elements in order, and the offset of the first element's data."""

    encoding: Encoding
    elements: tuple[Element, ...]
    body_offset: int
    comments: tuple[str, ...] = ()
    infos: tuple[str, ...] = ()

    @property
    def antialiased(self) -> bool:
        """Whether the PLY comments (of Brush or Postshot) declare antialiased splats."""
        matches = [match for line in self.comments if (match := _RENDER_MODE.fullmatch(line))]
        return bool(matches) and (matches[-1][1] or matches[-1][2]).lower() in ("mip", "1")

    @property
    def up(self) -> tuple[float, float, float] | None:
        """The upward direction that the last PLY comment on it declares (nerfstudio, Brush).

        ``y`` alone names the vertical axis, not its sign: Brush writes it for -y, that of 3DGS.
        """
        texts = [match[1] for line in self.comments if (match := _VERTICAL_AXIS.fullmatch(line))]
        directions = [up for text in texts if (up := _direction(text)) is not None]
        return directions[-1] if directions else None

    @property
    def unknown_comments(self) -> tuple[str, ...]:
        """The PLY comments that declare a vertical axis in words that are not known."""
        return tuple(
            line
            for line in self.comments
            if (match := _VERTICAL_AXIS.fullmatch(line)) and _direction(match[1]) is None
        )

    @property
    def byte_order(self) -> Literal["little", "big"]:
        """The byte order of binary values in the PLY file."""
        return "big" if self.encoding == "binary_big_endian" else "little"

    def find(self, name: str) -> Element | None:
        """Return the PLY element called ``name``, or None."""
        return next((item for item in self.elements if item.name == name), None)


def up_comment(up: tuple[float, float, float]) -> str:
    """Return the header line that declares an upward direction, in the words of Brush."""
    return "comment Vertical axis: {:.9g} {:.9g} {:.9g}".format(*up)


def _direction(text: str) -> tuple[float, float, float] | None:
    """Parse an axis (``z``, ``-y``) or three numbers as a unit vector."""
    word = text.strip().lower()
    axis = _AXES.get(word)
    if axis is not None:
        return axis
    try:
        x, y, z = (float(part) for part in re.split(r"[\s,;]+", word.strip("[]() ")))
    except ValueError:
        return None
    length = math.hypot(x, y, z)
    return (x / length, y / length, z / length) if 0 < length < math.inf else None


def parse_header(data: mmap.mmap) -> Header:
    """Parse the PLY header at the start of ``data``.

    Raises:
        FormatNotRecognised: The data does not begin with ``ply`` on a line of its own.
        FileTruncated: The data ends inside the header.
        HeaderMalformed: A line breaks the rules of the format.
    """
    lines, body_offset = _split(data)
    encoding: Encoding | None = None
    tables: dict[str, tuple[int, dict[str, Property]]] = {}
    comments: list[str] = []
    infos: list[str] = []
    for number, line in enumerate(lines, start=2):
        match line.split():
            case ["comment", *_]:
                comments.append(line.strip().removeprefix("comment").strip())
            case ["obj_info", *_]:
                infos.append(line.strip().removeprefix("obj_info").strip())
            case []:
                continue
            case ["format", name, "1.0"] if encoding is None and name in PLY_ENCODINGS:
                encoding = PLY_ENCODINGS[PLY_ENCODINGS.index(name)]  # for the type checker
            case ["element", name, count]:
                _add_element(tables, name, count, number)
            case ["property", "list", count_type, item_type, name] if tables:
                listing = Property(
                    name, _type_code(item_type, number), _count_type(count_type, number)
                )
                _add_property(tables, listing, number)
            case ["property", type_name, name] if tables:
                _add_property(tables, Property(name, _type_code(type_name, number)), number)
            case _:
                raise _malformed_error(number, quoted(line), _expected_syntax(line))
    if encoding is None:
        raise _malformed_error(2, "no format line", _expected_syntax("format"))
    elements = (
        Element(name, count, tuple(properties.values()))
        for name, (count, properties) in tables.items()
    )
    return Header(
        encoding=encoding,
        elements=tuple(elements),
        body_offset=body_offset,
        comments=tuple(comments),
        infos=tuple(infos),
    )


def _split(data: mmap.mmap) -> tuple[list[str], int]:
    """Return the lines of a PLY header between ``ply`` and ``end_header``, and the data offset."""
    first_bytes = data[:MAX_HEADER]
    if not first_bytes.startswith(MAGIC):
        raise not_recognised(
            first_bytes,
            "`ply` on a line of its own, the start of a PLY file",
            quoted(first_bytes[:4].decode("latin-1")),
        )
    end = re.search(rb"(?<=\n)end_header[ \t]*\r?\n", first_bytes)
    if end is None:
        raise _missing_end_error(len(first_bytes), len(data))
    lines = first_bytes[: end.start()].split(b"\n")
    return [
        _decode_header_line(line, number) for number, line in enumerate(lines[1:-1], 2)
    ], end.end()


def _decode_header_line(line: bytes, number: int) -> str:
    """Decode a line of a PLY header: free text may be UTF-8 or Latin-1, the others are ASCII."""
    if line.isascii():
        return line.decode("ascii")
    if line.split(maxsplit=1)[:1] in ([b"comment"], [b"obj_info"]):
        try:
            return line.decode("utf-8")
        except UnicodeDecodeError:
            return line.decode("latin-1")
    byte = next(byte for byte in line if byte > 127)
    raise _malformed_error(number, f"byte {byte:#04x} in {quoted(repr(line))}", "ASCII only")


def _missing_end_error(searched_bytes: int, size: int) -> FileTruncated | HeaderMalformed:
    message = f"the PLY header has no end_header in its first {searched_bytes} bytes"
    expected = "a line `end_header`"
    if searched_bytes < size:
        return HeaderMalformed(message, where="header", expected=expected)
    return FileTruncated(
        f"{message}, the whole file",
        where="header",
        expected=expected,
        hint="copy or download the file again",
    )


def _add_element(
    tables: dict[str, tuple[int, dict[str, Property]]], name: str, count: str, number: int
) -> None:
    if name in tables:
        raise _malformed_error(
            number, f"element {quoted(name)} for the second time", "unique names"
        )
    if not (count.isdigit() and len(count) <= MAX_COUNT_DIGITS):
        raise _malformed_error(
            number,
            f"element {quoted(name)} with {quoted(count)} rows",
            f"a whole number of rows, not negative, of {MAX_COUNT_DIGITS} digits at most",
        )
    tables[name] = int(count), {}


def _add_property(
    tables: dict[str, tuple[int, dict[str, Property]]], new_property: Property, number: int
) -> None:
    element, (_, properties) = next(reversed(tables.items()))
    if new_property.name in properties:
        description = f"property {quoted(new_property.name)} of element {quoted(element)}"
        raise _malformed_error(number, f"{description} for the second time", "unique names")
    properties[new_property.name] = new_property


def _type_code(type_name: str, number: int) -> str:
    if type_name not in PROPERTY_TYPES:
        raise _malformed_error(
            number, f"unknown type {quoted(type_name)}", f"one of {', '.join(PROPERTY_TYPES)}"
        )
    return PROPERTY_TYPES[type_name]


def _count_type(type_name: str, number: int) -> str:
    code = _type_code(type_name, number)
    if code[0] == "f":
        raise _malformed_error(
            number, f"a list counted in {quoted(type_name)}", "a whole-number type"
        )
    return code


def _expected_syntax(line: str) -> str:
    """Return the valid syntax of a PLY header line like ``line``, for error messages."""
    syntax_by_keyword = {
        "format": f"one line `format ENCODING 1.0`, ENCODING {' or '.join(PLY_ENCODINGS)}",
        "element": "`element NAME COUNT`",
        "property": "`property TYPE NAME` or `property list TYPE TYPE NAME`, after an element",
    }
    keyword = line.split()[0]
    return syntax_by_keyword.get(keyword, "format, element, property, comment or obj_info")


def _malformed_error(number: int, message: str, expected: str) -> HeaderMalformed:
    return HeaderMalformed(message, where=f"header line {number}", expected=expected)
