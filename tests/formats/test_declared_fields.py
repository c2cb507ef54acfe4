"""Declared fields of splat files: each is used, or named in one note."""

import struct
import warnings
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import (
    FormatWarning,
    NotSupported,
    Splats,
    ValueInvalid,
    codec_named,
    convert,
    open_splats,
    write_compressed_ply,
    write_ply,
    write_splat,
)
from gsgen.formats.editing.transforms import translated
from gsgen.formats.shared.splats import DEFAULT_UP
from gsgen.formats.shared.suspicions import suspicions
from gsgen.tiles.build.frame import turned_transform, upright_transform
from support.commands import shared
from support.splat_files import ksplat, scene

ENCODINGS = ("ascii", "binary_little_endian", "binary_big_endian")
C0 = 0.28209479177387814


def notes_of(path: Path, **options: bool) -> tuple[Splats, list[str]]:
    """Open a file, and return its content and what was noted, without the path."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", FormatWarning)
        content = open_splats(path, **options)
    assert isinstance(content, Splats)
    return content, [str(entry.message).removeprefix(f"{path}: ") for entry in caught]


def with_header(path: Path, old: bytes, new: bytes, body: bytes = b"") -> Path:
    """Replace a text in the header of a PLY file, and append to its body."""
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1) + body)
    return path


@pytest.mark.parametrize(
    ("comment", "up"),
    [
        ("Vertical Axis: z", (0, 0, 1)),
        ("vertical axis: Z", (0, 0, 1)),
        ("Vertical axis: y", DEFAULT_UP),
        ("Vertical Axis: x", (1, 0, 0)),
        ("Vertical axis: -z", (0, 0, -1)),
        ("Vertical axis: +y", (0, 1, 0)),
        ("Vertical axis: 0 1 0", (0, 1, 0)),
        ("Vertical axis: 0 -1 0", (0, -1, 0)),
        ("Vertical axis: [0.0, 0.0, 2.0]", (0, 0, 1)),
        ("Vertical axis: 0.6, 0.0, -0.8", (0.6, 0, -0.8)),
        ("up axis: z", (0, 0, 1)),
        ("made by hand", DEFAULT_UP),
    ],
)
@pytest.mark.parametrize("write", [write_ply, write_compressed_ply])
def test_a_vertical_axis_turns_the_scene_and_survives(tmp_path, comment, up, write) -> None:
    write(tmp_path / "a.ply", scene(20, 1))
    comment_line = f"comment {comment}\nelement vertex".encode()
    file = with_header(tmp_path / "a.ply", b"element vertex", comment_line)
    splats, notes = notes_of(file)
    assert splats.up == pytest.approx(up)
    assert not notes
    write(tmp_path / "b.ply", splats)
    assert open_splats(tmp_path / "b.ply").up == pytest.approx(up)


@pytest.mark.parametrize("text", ["w", "0 0 0", "1 2", "nan 0 0", "east"])
def test_an_unknown_vertical_axis_is_named(tmp_path: Path, text: str) -> None:
    write_ply(tmp_path / "a.ply", scene(3, 0))
    comment_line = f"comment Vertical axis: {text}\nelement vertex".encode()
    splats, notes = notes_of(with_header(tmp_path / "a.ply", b"element vertex", comment_line))
    assert splats.up == DEFAULT_UP
    assert notes == [f"not used: comment 'Vertical axis: {text}'"]


@pytest.mark.parametrize("name", ["spz", "glb", "sog", "splat"])
def test_formats_that_lose_the_upward_direction_say_so(tmp_path: Path, name: str) -> None:
    source = tmp_path / "a.ply"
    write_ply(source, scene(20, 0, up=(0.0, 0.0, 1.0), color_space="linear"))
    losses = convert(source, tmp_path / f"b.{name}", codec_named(name)).lost
    assert "the upward direction (0, 0, 1)" in losses
    assert ("the flag that the colours are linear" in losses) == (name != "glb")
    assert not convert(source, tmp_path / "b.ply", codec_named("ply")).lost


@pytest.mark.parametrize(
    "up", [(0, -1, 0), (0, 1, 0), (0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0.6, 0, -0.8)]
)
def test_a_tileset_stands_upright_whatever_axis_is_declared(up: tuple[float, ...]) -> None:
    matrix = np.array(turned_transform(upright_transform(), up)).reshape(4, 4).T
    np.testing.assert_allclose(matrix[:3, :3] @ up, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("space", ["srgb", "linear"])
def test_the_colour_space_of_a_ply_survives(tmp_path: Path, encoding: str, space: str) -> None:
    write_ply(tmp_path / "a.ply", scene(5, 1, color_space=space), format=encoding)
    splats, notes = notes_of(tmp_path / "a.ply")
    assert (splats.color_space, notes) == (space, [])


def test_an_unknown_colour_space_is_refused(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", scene(5, 1, color_space="linear"))
    content = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(content[:-1] + b"\x07")
    with pytest.raises(NotSupported, match="the colour space is 7"):
        open_splats(tmp_path / "a.ply")


def test_elements_of_sharp_beside_the_splats_are_named(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", scene(5, 0))
    elements = b"element image_size 2\nproperty uint image_size\nelement intrinsic 9\n"
    elements += b"property float intrinsic\nelement color_space 1\nproperty uchar color_space\n"
    body = struct.pack("<2I9fB", 640, 480, *range(9), 1)
    file = with_header(tmp_path / "a.ply", b"end_header", elements + b"end_header", body)
    splats, notes = notes_of(file)
    assert splats.color_space == "linear"
    assert notes == ["not used: element image_size (2 rows), element intrinsic (9 rows)"]


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("declared", "extra"), [(7, 3), (9, 1), (1, 9)])
def test_rows_beyond_the_declared_ones_are_noted(
    tmp_path: Path, encoding: str, declared: int, extra: int
) -> None:
    write_ply(tmp_path / "a.ply", scene(10, 0), format=encoding)
    count = f"element vertex {declared}".encode()
    splats, notes = notes_of(with_header(tmp_path / "a.ply", b"element vertex 10", count))
    assert len(splats) == declared
    assert len(notes) == 1
    assert f"after the {declared} rows" in notes[0]
    assert f"room for {extra} more rows" in notes[0]


def test_bytes_after_the_last_row_are_noted(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", scene(10, 0))
    splats, notes = notes_of(with_header(tmp_path / "a.ply", b"ply", b"ply", b"padding"))
    assert len(splats) == 10
    assert notes == ["not used: 7 bytes after the last row"]


@pytest.mark.parametrize(
    ("comment", "encoding"),
    [
        ("Trained by René", "utf-8"),
        ("Trained by René", "latin-1"),
        ("場景", "utf-8"),
        ("Größe: 3 µm", "latin-1"),
        ("emoji 🌲", "utf-8"),
    ],
)
@pytest.mark.parametrize("keyword", ["comment", "obj_info"])
def test_free_text_of_a_header_may_have_any_letters(tmp_path, comment, encoding, keyword) -> None:
    write_ply(tmp_path / "a.ply", scene(5, 0))
    line = f"{keyword} {comment}\nelement vertex".encode(encoding)
    splats, notes = notes_of(with_header(tmp_path / "a.ply", b"element vertex", line))
    assert (len(splats), notes) == (5, [])


def rgb_ply(
    path: Path, kind: str, encoding: str, degree: int, names: str = "red green blue"
) -> Path:
    """A splat PLY whose colours are red, green, blue in place of f_dc."""
    splats = scene(6, degree)
    colors = np.linspace(0, 1, 18).reshape(6, 3).round(1)
    rest = [f"f_rest_{index}" for index in range(3 * ((degree + 1) ** 2 - 1))]
    fields = [(name, "f4") for name in "xyz"] + [
        (n, "u1" if kind == "uchar" else "f4") for n in names.split()
    ]
    fields += [
        (name, "f4")
        for name in [
            *rest,
            "opacity",
            *(f"scale_{i}" for i in range(3)),
            *(f"rot_{i}" for i in range(4)),
        ]
    ]
    stored = np.rint(colors * 255) if kind == "uchar" else colors
    columns = [*splats.position.T, *stored.T, *np.zeros((len(rest), 6)), splats.logit_opacity]
    columns += [*splats.log_scale.T, *splats.rotation.T]
    kinds = {"u1": "uchar", "f4": "float"}
    lines = [f"property {kinds[code]} {name}" for name, code in fields]
    header = "\n".join(
        ["ply", f"format {encoding} 1.0", "element vertex 6", *lines, "end_header\n"]
    )
    if encoding == "ascii":
        rows = "\n".join(
            " ".join(f"{value:.9g}" for value in row) for row in zip(*columns, strict=True)
        )
        path.write_bytes((header + rows + "\n").encode())
        return path
    order = ">" if "big" in encoding else "<"
    table = np.empty(6, [(name, order + code) for name, code in fields])
    for (name, _), column in zip(fields, columns, strict=True):
        table[name] = column
    path.write_bytes(header.encode() + table.tobytes())
    return path


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("kind", ["uchar", "float"])
@pytest.mark.parametrize("degree", [0, 1])
def test_splats_with_rgb_colours_are_read(tmp_path, encoding, kind, degree) -> None:
    splats, notes = notes_of(rgb_ply(tmp_path / "a.ply", kind, encoding, degree))
    shown = 0.5 + C0 * splats.sh[:, 0]
    np.testing.assert_allclose(shown, np.linspace(0, 1, 18).reshape(6, 3).round(1), atol=2e-3)
    assert (splats.degree, notes) == (degree, [])


def test_a_compressed_ply_of_degree_0_may_declare_harmonics(tmp_path: Path) -> None:
    write_compressed_ply(tmp_path / "a.ply", scene(300, 0))
    file = with_header(tmp_path / "a.ply", b"end_header", b"element sh 300\nend_header")
    splats, notes = notes_of(file)
    assert (len(splats), splats.degree, notes) == (300, 0, [])


def zero_rotations(path: Path, name: str) -> Path:
    """A file of 40 splats, of which every fourth has a quaternion of zeros."""
    splats = scene(40, 0)
    file = path / f"a.{name}"
    if name == "ply":
        splats.rotation[::4] = 0
        content = b""
        header = ["ply", "format binary_little_endian 1.0", "element vertex 40"]
        names = [*"xyz", *(f"f_dc_{i}" for i in range(3)), "opacity"]
        names += [*(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
        header += [f"property float {entry}" for entry in names]
        columns = [splats.position, splats.sh[:, 0], splats.logit_opacity[:, None]]
        content = np.concatenate([*columns, splats.log_scale, splats.rotation], 1).tobytes()
        file.write_bytes("\n".join([*header, "end_header\n"]).encode() + content)
    elif name == "splat":
        write_splat(file, splats)
        records = np.frombuffer(bytearray(file.read_bytes()), np.uint8).reshape(40, 32)
        records[::4, 28:] = 128
        file.write_bytes(records.tobytes())
    elif name == "ksplat":
        content = bytearray(ksplat(splats, 0))
        for row in range(0, 40, 4):
            offset = 4096 + 1024 + 44 * row + 24
            content[offset : offset + 16] = bytes(16)
        file.write_bytes(content)
    return file


@pytest.mark.parametrize("name", ["ply", "splat", "ksplat"])
def test_rows_without_a_rotation_are_refused_or_dropped(tmp_path: Path, name: str) -> None:
    file = zero_rotations(tmp_path, name)
    with pytest.raises(ValueInvalid, match="10 of 40 rows have an all-zero quaternion"):
        codec_named(name).read(file)
    splats, notes = notes_of(file, drop_invalid=True) if name != "splat" else (None, [])
    if splats is not None:
        assert len(splats) == 30
        assert "10 rows have an all-zero quaternion" in notes[0]
        assert splats.rotation.any(axis=1).all()


@pytest.mark.parametrize("count", [100, 240, 5000])
@pytest.mark.parametrize("extent", [1.0, 10.0, 100.0])
@pytest.mark.parametrize("seed", range(3))
def test_activated_values_are_noted_and_right_ones_are_not(count, extent, seed) -> None:
    rng = np.random.default_rng(seed)
    splats = scene(count, 0, seed)
    position = rng.uniform(-extent, extent, (count, 3)).astype(np.float32)
    spacing = 2 * extent / np.sqrt(count)
    sizes = (spacing * rng.uniform(0.2, 1, (count, 3))).astype(np.float32)
    opacity = rng.uniform(0.05, 0.95, count).astype(np.float32)
    right = fields_of(splats, position, np.log(sizes), np.log(opacity / (1 - opacity)))
    assert suspicions(right) == []
    wrong = fields_of(splats, position, np.minimum(sizes, 0.3), opacity)
    messages = suspicions(wrong)
    assert any(text.startswith("all opacities lie from 0 to 1") for text in messages)
    if extent <= 1:
        assert any(text.startswith("all scales are positive") for text in messages)


def fields_of(splats: Splats, position, log_scale, logit_opacity) -> Splats:
    """Splats with other positions, sizes and opacities."""
    return Splats(
        position=position,
        rotation=splats.rotation,
        log_scale=log_scale.astype(np.float32),
        logit_opacity=logit_opacity.astype(np.float32),
        sh=splats.sh,
    )


def test_half_floats_as_integers_are_refused(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", scene(4, 0))
    header = (tmp_path / "a.ply").read_bytes().partition(b"end_header\n")[0]
    splats = scene(4, 0)
    columns = [splats.position, splats.sh[:, 0], splats.logit_opacity[:, None]]
    table = np.concatenate([*columns, splats.log_scale, splats.rotation], 1).astype("<f2")
    content = header.replace(b"float", b"ushort") + b"end_header\n" + table.tobytes()
    (tmp_path / "half.ply").write_bytes(content)
    with pytest.raises(ValueInvalid) as caught:
        open_splats(tmp_path / "half.ply")
    assert "PLY has no type for half floats" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "count", "note"),
    [
        ("activated-values/a3_ss264_linear_scales.ply", 240, "linear, not logarithms?"),
        ("gltf-beside-bin/g8_external.gltf", 240, ""),
        ("gsplat-compressed-sh0/gs0.compressed.ply", 900, ""),
        ("header-utf8/k9_utf8_comment.ply", 240, ""),
        ("mesh-beside-splats/g1_mesh_then_splat.glb", 240, "a mesh of 8 vertices"),
        ("rgb-splat-ply/a2_unity176_rgb_splat.ply", 240, ""),
        ("up-axis-nerfstudio/n1_vertical_axis_z.ply", 240, ""),
        ("zero-rows/z1_zero_rows.ply", 240, "300 rows have an all-zero quaternion"),
        ("zip-of-a-ply/q1_luma_download.zip", None, ""),
        ("double-coordinates/e1_utm_double.ply", 240, "relative to (448000, 5412000, 0)"),
    ],
)
def test_files_of_other_programs_are_read(name: str, count: int | None, note: str) -> None:
    splats, notes = notes_of(shared(f"data/faults/{name}"), drop_invalid=True)
    assert count in (None, len(splats))
    assert note in " ".join(notes)
    assert bool(notes) == bool(note)


def far_ply(path: Path, encoding: str, center: tuple[float, ...], kind: str = "double") -> Path:
    """A PLY of 60 splats around a far point, whose coordinates are doubles."""
    splats = scene(60, 0)
    position = np.asarray(center) + splats.position.astype(np.float64)
    names = [*(f"f_dc_{i}" for i in range(3)), "opacity", *(f"scale_{i}" for i in range(3))]
    names += [f"rot_{i}" for i in range(4)]
    columns = [splats.sh[:, 0], splats.logit_opacity[:, None], splats.log_scale, splats.rotation]
    others = np.concatenate(columns, axis=1)
    lines = [f"property {kind} {axis}" for axis in "xyz"] + [f"property float {n}" for n in names]
    header = "\n".join(
        ["ply", f"format {encoding} 1.0", "element vertex 60", *lines, "end_header\n"]
    )
    if encoding == "ascii":
        table = np.concatenate([position, others], axis=1)
        body = "".join(" ".join(f"{value:.17g}" for value in row) + "\n" for row in table).encode()
    else:
        order = ">" if "big" in encoding else "<"
        rows = np.empty(60, [("p", order + "f8", 3), ("o", order + "f4", len(names))])
        rows["p"], rows["o"] = position, others
        body = rows.tobytes()
    path.write_bytes(header.encode() + body)
    return path


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(
    "center", [(448262.5, 5411932.25, 80.0), (-4.2e6, 0, 17), (0, 0, 20000.5), (1e8, -1e8, 0)]
)
def test_far_double_coordinates_keep_their_width(tmp_path, encoding, center) -> None:
    splats, notes = notes_of(far_ply(tmp_path / "a.ply", encoding, center))
    expected = np.asarray(center) + scene(60, 0).position.astype(np.float64)
    restored = splats.position + np.asarray(splats.origin)
    np.testing.assert_allclose(restored, expected, atol=1e-4, rtol=0)
    assert "positions are relative to" in notes[0]
    with pytest.warns(FormatWarning, match="relative to"):
        result = convert(tmp_path / "a.ply", tmp_path / "b.spz", codec_named("spz"))
    assert "the origin" in " ".join(result.lost)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_near_double_coordinates_have_no_origin(tmp_path: Path, encoding: str) -> None:
    splats, notes = notes_of(far_ply(tmp_path / "a.ply", encoding, (3.0, -20.0, 0.5)))
    assert (splats.origin, notes) == ((0, 0, 0), [])


def test_far_files_are_merged_and_moved_in_doubles(tmp_path: Path) -> None:
    files = [
        far_ply(
            tmp_path / f"{index}.ply", "binary_little_endian", (448000.0 + 2000 * index, 5e6, 0)
        )
        for index in range(2)
    ]
    with pytest.warns(FormatWarning, match="relative to"):
        convert(
            files,
            tmp_path / "b.ply",
            codec_named("ply"),
            edits=[lambda splats: translated(splats, (-448000.0, -5e6, 0))],
        )
    merged = open_splats(tmp_path / "b.ply")
    near = scene(60, 0).position
    np.testing.assert_allclose(merged.position[:60], near, atol=1e-3)
    np.testing.assert_allclose(merged.position[60:], near + np.float32([2000, 0, 0]), atol=1e-3)
