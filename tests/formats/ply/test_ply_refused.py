import itertools
import struct
import warnings
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.formats import (
    BodyMalformed,
    FileTruncated,
    FormatError,
    FormatNotRecognised,
    FormatWarning,
    HeaderMalformed,
    NotSupported,
    PropertyMissing,
    ValueInvalid,
    ply_properties,
    read_ply,
)

CORE = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3"
CLOUD = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"]
RETRY_HINT = "copy or download the file again"


def ply(vertex: list[str], count: int = 1, encoding: str = "binary_little_endian") -> bytes:
    """A header whose vertices have the properties ``vertex``."""
    lines = "".join(f"property {line}\n" for line in vertex)
    head = f"ply\nformat {encoding} 1.0\nelement vertex {count}\n{lines}end_header\n"
    return head.encode()


def floats(names: str) -> list[str]:
    return [f"float {name}" for name in names.split()]


def refusal(tmp_path: Path, content: bytes, kind: type[FormatError]) -> str:
    """The text of the error over ``content``, without the path that it begins with."""
    file = tmp_path / "bad.ply"
    file.write_bytes(content)
    with pytest.raises(FormatError) as caught:
        read_ply(file)
    assert type(caught.value) is kind
    assert caught.value.path == str(file)
    return str(caught.value).removeprefix(f"{file}: ")


@pytest.mark.parametrize(
    ("line", "actual", "expected"),
    [
        ("element vertex -1", "element 'vertex' with '-1' rows", "not negative"),
        ("element vertex 1_0", "element 'vertex' with '1_0' rows", "a whole number"),
        ("element vertex 1e3", "element 'vertex' with '1e3' rows", "a whole number"),
        ("element vertex " + "9" * 19, "with '9999999999999999999' rows", "18 digits"),
        ("element vertex", "'element vertex'", "`element NAME COUNT`"),
        ("property float", "'property float'", "`property TYPE NAME`"),
        ("property float x", "'property float x'", "after an element"),
        ("format ascii 1.0", "'format ascii 1.0'", "one line `format ENCODING 1.0`"),
        ("vertices 3", "'vertices 3'", "format, element, property, comment or obj_info"),
    ],
)
def test_a_header_line_that_breaks_the_rules_is_named(tmp_path, line, actual, expected):
    content = f"ply\nformat ascii 1.0\ncomment -\n{line}\nend_header\n".encode()
    text = refusal(tmp_path, content, HeaderMalformed)
    assert text.startswith("header line 4: ")
    assert actual in text.splitlines()[0]
    assert expected in text.splitlines()[1]


@pytest.mark.parametrize(
    ("properties", "text"),
    [
        (
            ["float x", "half y"],
            "header line 5: unknown type 'half'\nexpected one of char, uchar, short, ushort, "
            "int, uint, float, double, int8, uint8, int16, uint16, int32, uint32, float32, "
            "float64",
        ),
        (
            ["float x", "double x"],
            "header line 5: property 'x' of element 'vertex' for the second time\n"
            "expected unique names",
        ),
        (
            ["float x", "list float int y"],
            "header line 5: a list counted in 'float'\nexpected a whole-number type",
        ),
    ],
)
def test_a_property_that_breaks_the_rules_is_named(tmp_path, properties, text):
    assert refusal(tmp_path, ply(properties), HeaderMalformed) == text


def test_an_element_cannot_come_twice(tmp_path):
    content = b"ply\nformat ascii 1.0\nelement a 1\nelement a 2\nend_header\n"
    assert refusal(tmp_path, content, HeaderMalformed) == (
        "header line 4: element 'a' for the second time\nexpected unique names"
    )


@pytest.mark.parametrize("line", ["format ascii 2.0", "format binary 1.0", "comment none"])
def test_the_format_line_has_to_be_known(tmp_path, line):
    content = f"ply\n{line}\nelement vertex 1\nend_header\n".encode()
    text = refusal(tmp_path, content, HeaderMalformed)
    assert text.startswith("header line 2: ")
    assert text.endswith(
        "one line `format ENCODING 1.0`, "
        "ENCODING ascii or binary_little_endian or binary_big_endian"
    )


def test_a_header_without_end_is_truncated(tmp_path):
    assert refusal(tmp_path, b"ply\nformat ascii 1.0\n", FileTruncated) == (
        "header: the PLY header has no end_header in its first 21 bytes, the whole file\n"
        f"expected a line `end_header`\n{RETRY_HINT}"
    )


def test_a_header_is_looked_for_in_one_mebibyte_only(tmp_path):
    content = b"ply\n" + b"comment -\n" * 200_000 + b"end_header\n"
    assert refusal(tmp_path, content, HeaderMalformed) == (
        "header: the PLY header has no end_header in its first 1048576 bytes\nexpected a line `end_header`"
    )


@pytest.mark.parametrize("line", ["property float größe", "element knöten 3", "formät ascii 1.0"])
def test_names_in_a_header_are_ascii(tmp_path, line):
    content = f"ply\nformat ascii 1.0\nelement vertex 1\n{line}\nend_header\n".encode()
    text = refusal(tmp_path, content, HeaderMalformed)
    assert text.startswith("header line 4: byte 0xc3 in")
    assert text.endswith("expected ASCII only")


@pytest.mark.parametrize(
    ("content", "actual"),
    [
        (b"plyx\n", "this is text that begins 'plyx'"),
        (b"PLY\n", "this is text that begins 'PLY'"),
        (b"\x1f\x8b\x08\x00", "this is a gzip file"),
        (b"\xfe\xff\x00\x01", "first bytes: 'þÿ\\x00\\x01'"),
    ],
)
def test_a_file_that_does_not_begin_with_ply_is_not_recognised(tmp_path, content, actual):
    text = refusal(tmp_path, content, FormatNotRecognised)
    assert text.splitlines()[:2] == [
        actual,
        "expected `ply` on a line of its own, the start of a PLY file",
    ]


@pytest.mark.parametrize(
    "removed", [["opacity"], ["f_dc_1", "rot_3"], ["x", "z"], ["scale_1", "scale_2"]]
)
def test_missing_properties_of_splats_are_named_and_no_others(tmp_path, removed):
    retained = [name for name in CORE.split() if name not in removed]
    text = refusal(tmp_path, ply(floats(" ".join(retained))), PropertyMissing)
    first, second = text.splitlines()
    assert first.startswith(
        f"element 'vertex': the properties {', '.join(removed)} are missing; found "
    )
    assert second == "expected all properties of a 3DGS PLY"


def test_one_property_of_splats_asks_for_the_others(tmp_path):
    text = refusal(tmp_path, ply([*CLOUD, "float f_rest_0"]), PropertyMissing)
    assert text == (
        "element 'vertex': the properties opacity, scale_0, scale_1, scale_2, rot_0, "
        "rot_1, rot_2, rot_3 are missing; "
        "found x, y, z, red, green, blue, f_rest_0\n"
        "expected all properties of a 3DGS PLY"
    )


def test_two_scales_look_like_2dgs(tmp_path):
    text = refusal(tmp_path, ply(floats(CORE.replace("scale_2 ", ""))), PropertyMissing)
    assert "the properties scale_2 are missing" in text
    assert text.endswith("a 2DGS file: `gsgen export 2dgs` reads its flat splats")


@pytest.mark.parametrize("count", [1, 3, 8, 10, 44, 46, 75])
def test_a_number_of_coefficients_of_no_degree_is_refused(tmp_path, count):
    sh_rest = [f"float f_rest_{index}" for index in range(count)]
    text = refusal(tmp_path, ply(floats(CORE) + sh_rest), PropertyMissing)
    assert text.startswith(f"element 'vertex': the file has {count} properties f_rest: f_rest_0")
    assert text.endswith("\nexpected 0, 9, 24, 45 or 72, for SH degree 0 to 4")


def test_a_gap_between_coefficients_is_named(tmp_path):
    sh_rest = [f"float f_rest_{index}" for index in [0, 1, 2, 3, 4, 5, 6, 7, 9]]
    text = refusal(tmp_path, ply(floats(CORE) + sh_rest), PropertyMissing)
    assert text.startswith("element 'vertex': the properties f_rest_8 are missing")


def test_points_need_a_colour(tmp_path):
    assert refusal(tmp_path, ply(CLOUD[:4]), PropertyMissing) == (
        "element 'vertex': the properties green, blue are missing; found x, y, z, red\n"
        "expected x, y, z and a colour, or all properties of a 3DGS PLY"
    )


def test_colours_are_bytes_or_floats(tmp_path):
    mixed = [*CLOUD[:3], "float red", "uchar green", "ushort blue"]
    assert refusal(tmp_path, ply(mixed), NotSupported) == (
        "properties red, green, blue: the colours have the types f4, u1, u2\n"
        "expected uchar (0 to 255) for all, or float (0 to 1) for all"
    )


def test_colours_in_floats_lie_in_the_unit_range(tmp_path):
    content = ply(floats("x y z red green blue")) + struct.pack("<6f", 0, 0, 0, 0, 255, 0)
    assert refusal(tmp_path, content, ValueInvalid) == (
        "property green: 1 of 1 rows are invalid: row 0 is 255\nexpected 0 <= value <= 1\n"
        "store colours from 0 to 255 as bytes (uchar, uint8)"
    )


def test_an_empty_cloud_is_refused(tmp_path):
    assert refusal(tmp_path, ply(CLOUD, count=0), ValueInvalid) == (
        "element 'vertex': the data have 0 splats or points\nexpected at least one\n"
        "the program that wrote the file may have dropped every point"
    )


def test_a_file_without_points_says_what_it_holds(tmp_path):
    content = b"ply\nformat ascii 1.0\nelement face 0\nelement edge 0\nend_header\n"
    assert refusal(tmp_path, content, PropertyMissing) == (
        "the PLY file has no element 'vertex', only face, edge\nexpected element 'vertex'"
    )


def test_columns_of_a_compressed_file_mean_nothing_alone(tmp_path):
    file = tmp_path / "packed.ply"
    file.write_bytes(ply(["uint packed_position", "uint packed_rotation"]))
    with pytest.raises(NotSupported) as caught:
        ply_properties(file)
    assert str(caught.value) == (
        f"{file}: element 'vertex', property packed_position: the file is a compressed PLY\n"
        "expected a plain 3DGS PLY\n"
        "unpack it: `gsgen convert packed.ply plain.ply`"
    )


def test_points_cannot_hold_lists(tmp_path):
    assert refusal(tmp_path, ply([*CLOUD, "list uchar int near"]), NotSupported) == (
        "element 'vertex': the properties near are lists\nexpected plain numbers"
    )


def test_more_points_than_the_file_can_hold_are_refused_with_numbers(tmp_path):
    header = ply(CLOUD, count=10**17)
    assert refusal(tmp_path, header + bytes(100), FileTruncated) == (
        "element 'vertex': the 100000000000000000 rows of 15 bytes need 1500000000000000000 "
        f"bytes, but 100 are left from byte {len(header)} on\n{RETRY_HINT}"
    )


def test_one_byte_too_few_is_one_too_few(tmp_path):
    text = refusal(tmp_path, ply(CLOUD, count=2) + bytes(29), FileTruncated)
    assert "2 rows of 15 bytes need 30 bytes, but 29 are left" in text


def test_more_lines_than_the_file_can_hold_are_refused_with_numbers(tmp_path):
    content = ply(CLOUD, count=10**17, encoding="ascii") + b"1 2 3 4 5 6\n"
    assert refusal(tmp_path, content, FileTruncated) == (
        "element 'vertex': the 100000000000000000 rows need 1199999999999999999 bytes or more, but "
        f"12 are left\n{RETRY_HINT}"
    )


def test_text_that_ends_early_says_after_which_row(tmp_path):
    content = ply(CLOUD, count=3, encoding="ascii") + b"1.5 2.5 3.5 0 0 255\n" * 2
    assert refusal(tmp_path, content, FileTruncated) == (
        f"element 'vertex': the file ends after 2 of 3 rows\n{RETRY_HINT}"
    )


@pytest.mark.parametrize(
    ("row", "text"),
    [
        (b"1 2 3 4 5", "row 1: 5 values\nexpected 6, one for each property"),
        (b"1 2 3 4 5 6 7", "row 1: 7 values\nexpected 6, one for each property"),
        (b"1 2 3 4 5 6 # 7", "row 1: 8 values\nexpected 6, one for each property"),
        (b"1 2 red 4 5 6", "row 1: 'red'\nexpected a number"),
        (b"1 2 \xff 4 5 6", "row 1: '\ufffd'\nexpected a number"),
    ],
)
def test_a_bad_row_of_text_is_named(tmp_path, row, text):
    content = ply(CLOUD, count=2, encoding="ascii") + b"1 2 3 4 5 6\n" + row + b"\n\n"
    assert refusal(tmp_path, content, BodyMalformed) == f"element 'vertex', {text}"


def test_rows_that_are_all_too_long_are_refused(tmp_path):
    content = ply(CLOUD, count=2, encoding="ascii") + b"1 2 3 4 5 6 7\n" * 2
    text = refusal(tmp_path, content, BodyMalformed)
    assert text == "element 'vertex', row 0: 7 values\nexpected 6, one for each property"


def test_a_line_without_end_is_not_read_into_memory(tmp_path, monkeypatch):
    monkeypatch.setattr("gsgen.formats.ply.ascii.MAX_LINE", 40)
    header = ply(CLOUD, encoding="ascii")
    assert refusal(tmp_path, header + b"1" * 41, BodyMalformed) == (
        f"byte {len(header)}: the line is longer than the limit of 40 bytes"
    )


def with_faces(kind: str, body: bytes, encoding: str = "binary_little_endian") -> bytes:
    faces = f"element face 2\nproperty list {kind} int ids\nelement vertex".encode()
    return ply(CLOUD, encoding=encoding).replace(b"element vertex", faces) + body


def test_a_list_of_negative_length_is_refused(tmp_path):
    content = with_faces("char", b"\x01\0\0\0\0\xff" + bytes(40))
    start = content.index(b"end_header\n") + len(b"end_header\n")
    assert refusal(tmp_path, content, BodyMalformed) == (
        f"property 'ids', row 1, byte {start + 5}: the list has -1 values\nexpected 0 values or more"
    )


@pytest.mark.parametrize("length", [b"\xff\xff\xff\xff", b"\x02\0\0\0" + bytes(8)])
def test_a_list_that_runs_over_the_end_is_refused(tmp_path, length):
    rows = 0 if length[0] == 255 else 1
    assert refusal(tmp_path, with_faces("uint", length), FileTruncated) == (
        f"element 'face': the file ends after {rows} of 2 rows\n{RETRY_HINT}"
    )


def test_text_that_ends_in_an_earlier_element_says_so(tmp_path):
    content = with_faces("uchar", b"5 1 2 3 4 5                \n", "ascii")
    text = refusal(tmp_path, content, FileTruncated)
    assert text == f"element 'face': the file ends after 1 of 2 rows\n{RETRY_HINT}"


VALID = {
    encoding: with_faces("uchar", body, encoding)
    for encoding, body in {
        "ascii": b"3 1 2 3\n0\n1 2 3 4 5 6\n",
        "binary_little_endian": struct.pack("<B3iB3f3B", 3, 1, 2, 3, 0, 1, 2, 3, 4, 5, 6),
        "binary_big_endian": struct.pack(">B3iB3f3B", 3, 1, 2, 3, 0, 1, 2, 3, 4, 5, 6),
    }.items()
}


def read_or_refuse(file: Path, content: bytes) -> bool:
    """Whether ``content`` is read; anything raised but a FormatError fails the test."""
    file.write_bytes(content)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FormatWarning)  # parts that are not used
            read_ply(file)
    except FormatError as error:
        text = str(error)
    else:
        return True
    assert 1 <= len(text.splitlines()) <= 3
    return False


@pytest.mark.parametrize("encoding", VALID)
def test_every_truncated_file_is_refused(tmp_path, encoding):
    content = VALID[encoding].rstrip(b"\n")
    assert read_or_refuse(tmp_path / "whole.ply", content)
    shorter = (content[:size] for size in range(1, len(content)))
    read = [read_or_refuse(tmp_path / "part.ply", part) for part in shorter]
    assert not any(read)


@settings(max_examples=250, deadline=None)
@given(
    encoding=st.sampled_from([*VALID]),
    edits=st.lists(
        st.tuples(st.integers(0, 400), st.integers(0, 3), st.binary(max_size=3)),
        min_size=1,
        max_size=4,
    ),
)
def test_a_mutated_file_is_read_or_refused_but_never_crashes(tmp_path_factory, encoding, edits):
    content = VALID[encoding]
    for offset, removed, inserted in edits:
        content = content[:offset] + inserted + content[offset + removed :]
    read_or_refuse(tmp_path_factory.getbasetemp() / "mutated.ply", content or b"-")


HEADER_WORDS = ["element", "vertex", "property", "list", "uchar", "float", "x", "0", "3", "-1"]
HEADER_WORDS += ["format", "ascii", "1.0", "comment", "\x1c", "\x00", "opacity"]


@settings(max_examples=150, deadline=None)
@given(lines=st.lists(st.lists(st.sampled_from(HEADER_WORDS), max_size=5), max_size=8))
def test_a_header_of_known_words_never_crashes(tmp_path_factory, lines):
    text = "\n".join(itertools.chain(["ply"], map(" ".join, lines), ["end_header", "1 2 3"]))
    read_or_refuse(tmp_path_factory.getbasetemp() / "words.ply", text.encode())
