import re
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.formats import (
    FormatError,
    FormatWarning,
    PointCloud,
    Splats,
    ValueInvalid,
    open_splats,
    read_ply,
)

CODES = {
    "char": "b",
    "uchar": "B",
    "short": "h",
    "ushort": "H",
    "int": "i",
    "uint": "I",
    "float": "f",
    "double": "d",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "float32": "f",
    "float64": "d",
}
ENCODINGS = ["ascii", "binary_little_endian", "binary_big_endian"]


def naive_rows(types: list[str], rows: list[list[float]], encoding: str) -> bytes:
    """What a PLY body is, said one value at a time."""
    if encoding == "ascii":
        return "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()
    order = "<" if "little" in encoding else ">"
    out = b""
    for row in rows:
        for kind, value in zip(types, row, strict=True):
            number = value if kind in ("float", "double", "float32", "float64") else int(value)
            out += struct.pack(order + CODES[kind], number)
    return out


def naive_ply(
    properties: dict[str, str],
    rows: list[list[float]],
    encoding: str = "binary_little_endian",
    before: tuple[str, bytes] = ("", b""),
    after: tuple[str, bytes] = ("", b""),
) -> bytes:
    lines = [f"property {kind} {name}\n" for name, kind in properties.items()]
    head = f"ply\nformat {encoding} 1.0\n{before[0]}element vertex {len(rows)}\n"
    text = head + "".join(lines) + after[0] + "end_header\n"
    body = naive_rows(list(properties.values()), rows, encoding)
    return text.encode() + before[1] + body + after[1]


def splat_properties(degree: int) -> list[str]:
    sh_count = 3 * ((degree + 1) ** 2 - 1)
    return [
        *("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{i}" for i in range(sh_count)),
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]


def check_splat(splats: Splats, row: int, value: dict[str, float]) -> None:
    """Compare one splat with its properties by name, one number at a time."""
    expected = {name: np.float32(number) for name, number in value.items()}
    assert [*splats.position[row]] == [expected[n] for n in "xyz"]
    assert [*splats.rotation[row]] == [expected[f"rot_{i}"] for i in range(4)]
    assert [*splats.log_scale[row]] == [expected[f"scale_{i}"] for i in range(3)]
    assert splats.logit_opacity[row] == expected["opacity"]
    remaining = splats.sh.shape[1] - 1
    for channel in range(3):
        assert splats.sh[row, 0, channel] == expected[f"f_dc_{channel}"]
        for k in range(remaining):
            assert splats.sh[row, k + 1, channel] == expected[f"f_rest_{channel * remaining + k}"]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4])
def test_higher_coefficients_go_from_channel_major_to_coefficient_major(tmp_path, degree, encoding):
    names = splat_properties(degree)
    count = (degree + 1) ** 2 - 1
    values = {name: float(index) for index, name in enumerate(names)}
    for channel in range(3):  # the label says which: 1203 is channel 1, coefficient 3
        for k in range(1, count + 1):
            values[f"f_rest_{channel * count + k - 1}"] = 1000.0 * channel + 200 + k
    file = tmp_path / "labelled.ply"
    file.write_bytes(naive_ply(dict.fromkeys(names, "float"), [[*values.values()]], encoding))

    splats = read_ply(file)

    assert isinstance(splats, Splats)
    assert splats.degree == degree
    for channel in range(3):
        labels = [1000 * channel + 200 + k for k in range(1, count + 1)]
        assert splats.sh[0, 1:, channel].tolist() == labels
    check_splat(splats, 0, values)


@settings(max_examples=60, deadline=None)
@given(data=st.data(), degree=st.sampled_from([0, 1, 2]), encoding=st.sampled_from(ENCODINGS))
def test_properties_are_found_by_name_in_any_order_and_type(
    tmp_path_factory, data, degree, encoding
):
    names = data.draw(st.permutations([*splat_properties(degree), "nx", "ny", "nz", "label"]))
    kinds = data.draw(st.lists(st.sampled_from([*CODES]), min_size=len(names)))
    types = dict(zip(names, kinds, strict=False))
    number = {
        name: st.floats(-1e6, 80.0, width=32)
        if CODES[kind] in "fd"
        else st.integers(1, 80).map(float)
        for name, kind in types.items()
    }
    rows = data.draw(st.lists(st.fixed_dictionaries(number), min_size=1, max_size=3))
    for row in rows:
        row["rot_2"] = row["rot_2"] or 1.0
    file = tmp_path_factory.mktemp("ply") / "shuffled.ply"
    file.write_bytes(naive_ply(types, [[row[n] for n in names] for row in rows], encoding))

    with pytest.warns(FormatWarning, match="not used: .*label"):
        splats = read_ply(file)

    assert isinstance(splats, Splats)
    for index, row in enumerate(rows):
        check_splat(splats, index, row)


def test_chunks_join_without_a_seam(tmp_path):
    count = 10_000  # more than two chunks
    table = np.arange(count * 3, dtype="<f4").reshape(count, 3)
    packed = np.zeros(count, [("p", "<f4", 3), ("c", "u1", 3)])
    packed["p"] = table
    packed["c"] = np.arange(count)[:, None] % 256
    kinds = dict.fromkeys(("x", "y", "z"), "float") | dict.fromkeys(
        ("red", "green", "blue"), "uchar"
    )
    binary, text = tmp_path / "binary.ply", tmp_path / "text.ply"
    binary.write_bytes(naive_ply(kinds, []).replace(b"vertex 0", b"vertex %d" % count))
    with binary.open("ab") as file:
        file.write(packed.tobytes())
    rows = [[*map(float, p), *map(int, c)] for p, c in packed.tolist()]
    text.write_bytes(naive_ply(kinds, rows, "ascii"))

    for cloud in (read_ply(binary), read_ply(text)):
        assert isinstance(cloud, PointCloud)
        np.testing.assert_array_equal(cloud.position, table)
        np.testing.assert_array_equal(cloud.color, packed["c"] / np.float32(255))


@pytest.mark.parametrize("kind", ["float", "double", "float32", "float64"])
def test_colours_in_floats_are_kept(tmp_path, kind):
    types = dict.fromkeys(("x", "y", "z", "r", "g", "b"), kind)
    file = tmp_path / "cloud.ply"
    file.write_bytes(naive_ply(types, [[1.0, 2.0, 3.0, 0.0, 0.25, 1.0]]))
    cloud = read_ply(file)
    assert isinstance(cloud, PointCloud)
    assert cloud.position.tolist() == [[1, 2, 3]]
    assert cloud.color.tolist() == [[0, 0.25, 1]]


@pytest.mark.parametrize(
    "names",
    [("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue")],
)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_colours_in_bytes_come_out_in_the_unit_range(tmp_path, names, encoding):
    types = dict.fromkeys("xyz", "float") | dict.fromkeys(names, "uchar") | {"alpha": "uchar"}
    file = tmp_path / "cloud.ply"
    file.write_bytes(naive_ply(types, [[1.0, 2.0, 3.0, 0, 51, 255, 7]], encoding))
    with pytest.warns(FormatWarning, match="not used: property alpha"):
        cloud = read_ply(file)
    assert isinstance(cloud, PointCloud)
    assert cloud.color.tolist() == [[0, np.float32(51) / np.float32(255), 1]]


def test_a_full_set_of_colour_names_wins_over_a_part_of_one(tmp_path):
    types = dict.fromkeys("xyzr", "float")  # r is a radius here
    types |= dict.fromkeys(("diffuse_red", "diffuse_green", "diffuse_blue"), "uchar")
    file = tmp_path / "cloud.ply"
    file.write_bytes(naive_ply(types, [[1.0, 2.0, 3.0, 9.0, 255, 0, 0]]))
    with pytest.warns(FormatWarning, match="not used: property r$"):
        cloud = read_ply(file)
    assert isinstance(cloud, PointCloud)
    assert cloud.color.tolist() == [[1, 0, 0]]


FACES = "element face 2\nproperty uchar weight\nproperty list uchar int vertex_indices\n"
FACES += "property list ushort float uv\n"
CAMERA = "element camera 1\nproperty double fov\nproperty short id\n"


def faces(encoding: str) -> bytes:
    """Two faces with lists, of three and of no indices, and a camera."""
    if encoding == "ascii":
        return b"7 3 0 1 2 2 0.5 0.5\n\n8 0 0\n0.8 -3\n"
    order = "<" if "little" in encoding else ">"
    first = struct.pack(f"{order}BB3iH2f", 7, 3, 0, 1, 2, 2, 0.5, 0.5)
    return first + struct.pack(f"{order}BBHdh", 8, 0, 0, 0.8, -3)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_other_elements_are_passed_over_before_and_after_the_points(tmp_path, encoding):
    types = dict.fromkeys("xyz", "float") | dict.fromkeys(("red", "green", "blue"), "uchar")
    other = (FACES + CAMERA, faces(encoding))
    rows: list[list[float]] = [[1.0, 2.0, 3.0, 0, 0, 255], [4.0, 5.0, 6.0, 255, 0, 0]]
    around = naive_ply(types, rows, encoding, before=other, after=("element sky 0\n", b""))
    trailing_element = naive_ply(types, rows, encoding, after=other)
    for content in (around, trailing_element):
        file = tmp_path / "mesh.ply"
        file.write_bytes(content)
        with pytest.warns(FormatWarning, match="element face .2 rows., element camera .1 rows"):
            cloud = read_ply(file)
        assert isinstance(cloud, PointCloud)
        assert cloud.position.tolist() == [[1, 2, 3], [4, 5, 6]]
        assert cloud.color.tolist() == [[0, 0, 1], [1, 0, 0]]


def test_carriage_returns_comments_and_blank_lines_are_tolerated(tmp_path):
    file = tmp_path / "crlf.ply"
    file.write_bytes(
        b"ply\r\nformat ascii 1.0\r\ncomment end_header\r\nobj_info made by hand\r\n\r\n"
        b"element vertex 2\r\nproperty float x\r\nproperty float y\r\nproperty float z\r\n"
        b"property uchar red\r\nproperty uchar green\r\nproperty uchar blue\r\n"
        b"end_header\r\n1 2 3 0 0 255\r\n\r\n  4\t5 6 255 0 0"
    )
    cloud = read_ply(file)
    assert isinstance(cloud, PointCloud)
    assert cloud.position.tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_meaningful_infinities_are_kept(tmp_path, encoding):
    names = splat_properties(0)
    rows = [dict.fromkeys(names, 1.0) for _ in range(2)]
    rows[0] |= {"opacity": np.inf, "scale_2": -np.inf}
    rows[1] |= {"opacity": -np.inf}
    table = [[row[name] for name in names] for row in rows]
    file = tmp_path / "infinite.ply"
    file.write_bytes(naive_ply(dict.fromkeys(names, "float"), table, encoding))
    splats = read_ply(file)
    assert isinstance(splats, Splats)
    assert splats.logit_opacity.tolist() == [np.inf, -np.inf]
    assert splats.log_scale[0].tolist() == [1, 1, -np.inf]


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("x", "nan", "a finite number"),
        ("f_rest_8", "nan", "a finite number"),
        ("rot_3", "-inf", "a finite number"),
        ("opacity", "nan", "a finite number or +inf or -inf"),
        ("scale_1", "inf", "a finite number or -inf"),
    ],
)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_undrawable_values_are_refused_by_name_row_and_count(
    tmp_path, name, value, expected, encoding
):
    names = splat_properties(1)
    rows = [dict.fromkeys(names, 0.5) for _ in range(5)]
    rows[2][name] = rows[4][name] = float(value)
    table = [[row[n] for n in names] for row in rows]
    file = tmp_path / "bad.ply"
    file.write_bytes(naive_ply(dict.fromkeys(names, "float"), table, encoding))
    with pytest.raises(FormatError) as caught:
        read_ply(file)
    assert str(caught.value) == (
        f"{file}: property {name}: 2 of 5 rows are invalid: row 2 is {value}\nexpected {expected}\n"
        "`gsgen convert --drop-invalid` writes a file without such rows"
    )
    text = (
        f"{file}: 2 of 5 rows cannot be drawn and are left out; row 2 is the first, "
        f"where {name} is {value}"
    )
    with pytest.warns(FormatWarning, match=re.escape(text)):
        splats = read_ply(file, drop_invalid=True)
    remaining = tmp_path / "rest.ply"
    remaining.write_bytes(
        naive_ply(dict.fromkeys(names, "float"), [table[n] for n in (0, 1, 3)], encoding)
    )
    expected = read_ply(remaining, drop_invalid=True)  # which has nothing to be warned of
    for array in ("position", "rotation", "log_scale", "logit_opacity", "sh"):
        np.testing.assert_array_equal(getattr(splats, array), getattr(expected, array))


@pytest.mark.parametrize("names", [splat_properties(0), ["x", "y", "z", "red", "green", "blue"]])
def test_where_no_row_can_be_drawn_nothing_is_read(tmp_path, names):
    rows = [[np.nan, *[0.5] * (len(names) - 1)] for _ in range(3)]
    file = tmp_path / "bad.ply"
    file.write_bytes(naive_ply(dict.fromkeys(names, "float"), rows))
    with pytest.raises(ValueInvalid, match="property x: 3 of 3 rows are invalid: row 0 is nan"):
        open_splats(file, drop_invalid=True)


def test_nonfinite_points_can_be_skipped(tmp_path):
    names = ["x", "y", "z", "red", "green", "blue"]
    rows = [[1, 2, 3, 0.5, 0.5, 0.5], [1, np.inf, 3, 0.5, 0.5, 0.5]]
    file = tmp_path / "cloud.ply"
    file.write_bytes(naive_ply(dict.fromkeys(names, "float"), rows))
    with pytest.raises(ValueInvalid, match="property y: 1 of 2 rows"):
        open_splats(file)
    with pytest.warns(FormatWarning, match=r"1 of 2 rows .* row 1 is the first, where y is inf"):
        cloud = open_splats(file, drop_invalid=True)
    assert cloud.position.tolist() == [[1, 2, 3]]


def test_a_double_too_large_for_a_float_is_refused(tmp_path):
    names = splat_properties(0)
    row = [1e300 if name == "y" else 0.5 for name in names]
    file = tmp_path / "large.ply"
    file.write_bytes(naive_ply(dict.fromkeys(names, "double"), [row]))
    with pytest.raises(FormatError, match=r"property y: 1 of 1 rows are invalid: row 0 is inf"):
        read_ply(file)


def test_nan_in_a_property_that_is_not_needed_does_no_harm(tmp_path):
    names = ["nx", *splat_properties(0)]
    file = tmp_path / "normals.ply"
    row = [np.nan] + [0.5] * (len(names) - 1)
    file.write_bytes(naive_ply(dict.fromkeys(names, "float"), [row]))
    with pytest.warns(FormatWarning, match="not used: property nx"):
        assert isinstance(read_ply(file), Splats)
