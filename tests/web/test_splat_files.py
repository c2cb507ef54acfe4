"""Splat files that a page reads, beside what Python reads: the same rows, to the last digits."""

import gzip
import io
import json
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.formats import (
    PointCloud,
    Splats,
    open_splats,
    write_compressed_ply,
    write_glb,
    write_ply,
    write_sog,
    write_splat,
    write_spz,
)
from gsgen.formats.shared.axes import flip
from gsgen.runtime.scene.splat_data import SplatData
from support.foreign_files import FOREIGN_FILES
from support.splat_files import ksplat, sog_files, sog_version_1, zipped
from support.web.pages import WebSite, unpacked

pytestmark = pytest.mark.slow

Files = dict[str, bytes]
"""Name → content; a name is that of a case, or of a file that a case refers to."""


def random_splats(degree: int, count: int = 200) -> Splats:
    rng = np.random.default_rng(degree)
    harmonics = rng.normal(size=(count, (degree + 1) ** 2, 3), scale=0.3)
    rotation = rng.normal(size=(count, 4))
    rotation[0] = 0, 0, 0, 2
    return Splats(
        position=rng.normal(size=(count, 3)).astype(np.float32),
        rotation=rotation.astype(np.float32),
        log_scale=rng.uniform(-6, 0, (count, 3)).astype(np.float32),
        logit_opacity=rng.normal(size=count, scale=3).astype(np.float32),
        sh=harmonics.astype(np.float32),
    )


def written(folder: Path, write: Callable[..., None], *arguments: Any, **options: Any) -> bytes:
    path = folder / "written"
    write(path, *arguments, **options)
    return path.read_bytes()


def ply_files(folder: Path) -> Files:
    files = {
        f"{name}-{degree}.ply": written(folder, write_ply, random_splats(degree), format=name)
        for name in ("ascii", "binary_little_endian", "binary_big_endian")
        for degree in (0, 1, 3, 4)
    }
    files["antialiased.ply"] = written(
        folder, write_ply, replace(random_splats(1), antialiased=True, up=(0.0, 0.0, 1.0))
    )
    files["linear.ply"] = written(
        folder, write_ply, replace(random_splats(0), color_space="linear")
    )
    files |= {
        f"packed-{degree}.compressed.ply": written(
            folder, write_compressed_ply, random_splats(degree, 700)
        )
        for degree in (0, 2, 3)
    }
    files["mixed types.ply"] = mixed_ply()
    files["faulty rows.ply"] = faulty_ply(folder)
    far = random_splats(1)
    files["far.ply"] = text_ply(np.add(far.position, [449_000.123, 5_411_000.5, 40]))
    files["points.ply"] = written(folder, write_ply, random_points(40))
    files["point.ply"] = written(folder, write_ply, random_points(1))
    return files


def text_ply(points: np.ndarray) -> bytes:
    """A PLY of points as text, with more digits than float32 has."""
    lines = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"property uchar {color}" for color in ("red", "green", "blue")]
    rows = [" ".join(f"{x:.6f}" for x in point) + " 1 2 255" for point in points]
    return "\n".join([*lines, "end_header", *rows, ""]).encode()


def random_points(count: int) -> PointCloud:
    rng = np.random.default_rng(5)
    position = rng.normal(size=(count, 3)).astype(np.float32)
    return PointCloud(position, rng.uniform(size=(count, 3)).astype(np.float32))


def mixed_ply() -> bytes:
    """A PLY of doubles far away, bytes for colours, a filter, and an element with a list before."""
    rng = np.random.default_rng(6)
    names = ["x", "y", "z", *(f"rot_{i}" for i in range(4)), *(f"scale_{i}" for i in range(3))]
    fields = [(name, "<f8") for name in names[:3]] + [(name, "<f4") for name in names[3:]]
    fields += [
        ("opacity", "<f4"),
        ("filter_3D", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
    ]
    rows = np.zeros(50, fields)
    for name, kind in fields:
        rows[name] = rng.integers(0, 256, 50) if kind == "u1" else rng.normal(size=50)
    rows["x"] += 500_000
    rows["y"] += 4_000_000
    rows["filter_3D"] = np.where(np.arange(50) % 2, 0, np.abs(rows["filter_3D"]))
    words = {"<f8": "double", "<f4": "float", "u1": "uchar"}
    lines = ["ply", "format binary_little_endian 1.0", "comment Vertical axis: 0 3 4"]
    lines += ["element face 2", "property list uchar int corners", "element vertex 50"]
    lines += [f"property {words[kind]} {name}" for name, kind in fields]
    faces = b"\x03" + bytes(12) + b"\x01" + bytes(4)
    return "\n".join([*lines, "end_header", ""]).encode() + faces + rows.tobytes()


def faulty_ply(folder: Path) -> bytes:
    """A PLY with rows that cannot be drawn, of each kind, and some that only look so."""
    data = bytearray(written(folder, write_ply, random_splats(1)))
    start = data.index(b"end_header\n") + len(b"end_header\n")
    table = np.frombuffer(data, "<f4", offset=start).reshape(200, -1).copy()
    names = [line.split()[-1] for line in data[:start].decode().splitlines() if "float" in line]
    column = {name: index for index, name in enumerate(names)}
    table[3, column["x"]] = np.nan
    table[4, column["rot_0"] : column["rot_0"] + 4] = 0
    table[5, column["scale_1"]] = 90
    table[6, column["opacity"]] = np.nan
    table[7, column["f_rest_2"]] = np.inf
    table[8, column["opacity"]], table[9, column["opacity"]] = np.inf, -np.inf
    table[10, column["scale_2"]] = -np.inf
    return bytes(data[:start]) + table.tobytes()


def spz_files(folder: Path) -> Files:
    splats = {degree: random_splats(degree) for degree in (0, 1, 3, 4)}
    files = {
        f"v{version}-{degree}.spz": written(folder, write_spz, splats[degree], version=version)
        for version in (1, 2, 3, 4)
        for degree in splats
    }
    files["antialiased.spz"] = written(
        folder, write_spz, replace(splats[1], antialiased=True), version=4
    )
    files["unpacked.spz"] = gzip.decompress(files["v2-1.spz"])
    files["packed again.spz.gz"] = gzip.compress(files["v4-1.spz"])
    return files


def glb_files(folder: Path) -> Files:
    files = {
        f"degree-{degree}.glb": written(folder, write_glb, random_splats(degree))
        for degree in (0, 1, 3)
    }
    linear = replace(random_splats(0), color_space="linear")
    files["linear.glb"] = written(folder, write_glb, linear)
    text = files["degree-1.glb"]
    length = int.from_bytes(text[12:16], "little")
    document = json.loads(text[20 : 20 + length])
    document["buffers"][0]["uri"] = "beside%20it.bin"
    document["nodes"] = [
        {"children": [1, 2], "translation": [1, 2, 3]},
        {"mesh": 0, "rotation": [0.5, 0.5, 0.5, 0.5], "scale": [2, 2, 2]},
        {"mesh": 0, "matrix": [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 5, 0, 0, 1]},
    ]
    files["turned.gltf"] = json.dumps(document).encode()
    files["beside it.bin"] = text[28 + length :]
    return files


def sog_archives(folder: Path) -> Files:
    files = {}
    for degree in range(4):
        splats = random_splats(degree)
        # Colours of pixels whose alpha is 0 or 1 survive only where nothing is multiplied by alpha.
        splats.logit_opacity[:40] = np.repeat([-9, -5.5], 20)
        files[f"degree-{degree}.sog"] = written(folder, write_sog, splats)
    files["deflated.sog"] = zipped(sog_files(), zipfile.ZIP_DEFLATED)
    files |= {
        f"version 1, {bands}.sog": zipped(sog_version_1(sog_files(bands=bands))) for bands in (0, 3)
    }
    members = sog_files(bands=2, seed=1)
    files["in a folder.sog"] = zipped({f"scene/{name}": data for name, data in members.items()})
    return files


def other_files(folder: Path) -> Files:
    splats = random_splats(2)
    plain = written(folder, write_ply, splats)
    files = {f"level-{level}.ksplat": ksplat(splats, level) for level in (0, 1, 2)}
    files["plain.splat"] = written(folder, write_splat, splats)
    files["plain.ply.gz"] = gzip.compress(plain)
    files["one file.zip"] = zipped(
        {"notes.txt": b"Hello", "__MACOSX/a.ply": plain, "a/b.ply": plain}
    )
    files["packed splat.zip"] = zipped({"a.splat": files["plain.splat"]}, zipfile.ZIP_DEFLATED)
    return files


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Files, Path]:
    """Return all files, and the folder that holds them."""
    scratch, folder = (tmp_path_factory.mktemp(name) for name in ("scratch", "files"))
    files = {}
    for make in (ply_files, spz_files, glb_files, sog_archives, other_files):
        files |= make(scratch)
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    return files, folder


def cases(files: Files) -> list[str]:
    """Return the names of the files that are opened, without those that others refer to."""
    return [name for name in files if not name.endswith(".bin") and "/" not in name]


def expected_rows(path: Path, transform: np.ndarray) -> tuple[SplatData, Any]:
    content = open_splats(path, drop_invalid=True)
    if isinstance(content, PointCloud):
        return SplatData.from_points(content), content.origin
    assert isinstance(content, Splats)
    x, y, z = (int(sign) for sign in np.diag(transform)[:3])
    return SplatData.from_splats(flip(content, (x, y, z))), content.origin


def packed_parts(parts: list[dict[str, Any]]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    for part in parts:
        count, stride = part["count"], part["stride"]
        rows = unpacked(part["rows"], np.float32).reshape(-1, 10)[:count]
        appearance = unpacked(part["appearance"], np.float32).reshape(-1, stride)[:count]
        yield rows, appearance[:, : part["channels"]]


@pytest.mark.filterwarnings("ignore::gsgen.formats.FormatWarning")
@pytest.mark.parametrize("in_worker", [True, False], ids=["worker", "page"])
def test_files_are_read_as_python_reads_them(
    in_worker: bool, files: tuple[Files, Path], site: WebSite
) -> None:
    contents, folder = files
    site.contents.update({f"/files/{name}": content for name, content in contents.items()})
    names = cases(contents) if in_worker else ["mixed types.ply", "v4-3.spz", "degree-3.sog"]
    results = site.call("splatFiles", [f"/files/{name}" for name in names], in_worker)
    for name, result in zip(names, results, strict=True):
        assert "error" not in result, (name, result)
        parts = result["parts"]
        if name == "turned.gltf":
            continue  # whose parts have transforms: see below
        # Rows keep the axes of their file; the transform mirrors them to those of a camera.
        transform = np.array(parts[0]["transform"]).reshape(4, 4)
        np.testing.assert_array_equal(np.abs(transform[:, :3]), np.eye(4)[:, :3], err_msg=name)
        data, origin = expected_rows(folder / name, transform)
        np.testing.assert_array_equal(transform[:3, 3], origin, err_msg=name)
        rows, appearance = (
            np.concatenate(arrays) for arrays in zip(*packed_parts(parts), strict=True)
        )
        assert rows.shape == data.rows.shape, name
        assert {part["antialias"] for part in parts} == {data.antialias}, name
        assert {part["colorSpace"] for part in parts} == {data.color_space}, name
        assert {part["space"] for part in parts} == {data.space}, name
        scale = np.abs(data.rows[:, 4:]).max(axis=1, keepdims=True)
        assert rows.dtype == appearance.dtype == np.float32
        close_to_the_last_digit(rows[:, :4], data.rows[:, :4], 0, name)
        close_to_the_last_digit(rows[:, 4:], data.rows[:, 4:], 1e-7 * scale, name)
        close_to_the_last_digit(appearance, data.appearance, 0, name)


def close_to_the_last_digit(actual: np.ndarray, expected: np.ndarray, room: Any, name: str) -> None:
    """Compare numbers, which may differ by a unit in their last place, or by ``room``."""
    np.testing.assert_array_equal(np.isfinite(actual), np.isfinite(expected), err_msg=name)
    excess = np.abs(actual - expected) - np.spacing(np.abs(expected)) - room
    assert excess.max() <= 0, (name, np.argwhere(excess > 0)[:5], excess.max())


def test_nodes_of_gltf_place_their_splats(files: tuple[Files, Path], site: WebSite) -> None:
    contents, folder = files
    site.contents.update({f"/files/{name}": content for name, content in contents.items()})
    (result,) = site.call("splatFiles", ["/files/turned.gltf"])
    data = SplatData.from_splats(open_splats(folder / "turned.gltf"))
    assert len(result["parts"]) == 2
    rows = np.concatenate([
        placed_rows(rows, np.array(part["transform"]).reshape(4, 4))
        for part, (rows, _) in zip(result["parts"], packed_parts(result["parts"]), strict=True)
    ])  # fmt: skip
    np.testing.assert_allclose(rows, data.rows, rtol=1e-4, atol=1e-5)


def placed_rows(rows: np.ndarray, transform: np.ndarray) -> np.ndarray:
    linear = transform[:3, :3]
    index = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
    covariance = linear @ rows[:, 4:][:, index] @ linear.T
    upper = covariance.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]]
    return np.column_stack([rows[:, :3] @ linear.T + transform[:3, 3], rows[:, 3], upper])


def test_an_upward_direction_that_a_file_declares_is_told(
    files: tuple[Files, Path], site: WebSite
) -> None:
    contents, _ = files
    names = ("antialiased.ply", "mixed types.ply", "plain.splat")
    site.contents.update({f"/files/{name}": contents[name] for name in names})
    results = site.call("splatFiles", [f"/files/{name}" for name in names])
    assert [result["parts"][0]["up"] for result in results] == [[0, 0, 1], [0, 0.6, 0.8], None]


_GROUPS = {name: {"files": ["a.webp"]} for name in ("means", "scales", "quats", "sh0")}


def sog_of(**changes: object) -> bytes:
    """Return a zip archive that holds a meta.json, and an image that is none."""
    stream = io.BytesIO()
    meta = {"version": 2, "count": 1, **changes}
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("meta.json", json.dumps(meta))
        archive.writestr("b.webp", b"")
    return stream.getvalue()


def header(*lines: str) -> bytes:
    return "\n".join(["ply", *lines, "end_header", ""]).encode()


_LITTLE = "format binary_little_endian 1.0"
WRONG_FILES: dict[str, tuple[bytes, str]] = {
    "no JSON": (b"glTF----", "is not a .glb file"),
    "empty": (b"", "is an empty file"),
    "cut gzip": (b"\x1f\x8bnothing", "cannot be read to its end"),
    "short spz": (b"NGSP", "ends within its header"),
    "cut zip": (b"PK\x03\x04" + bytes(40), "damaged or cut off ZIP archive"),
    "old sog": (sog_of(version=3, **_GROUPS), "version 3 of SOG"),
    "no image": (sog_of(**_GROUPS), "has no file a.webp"),
    "wrong place": (sog_of()[:-6] + b"\xff\xff\xff\x0f\0\0", "damaged or cut off ZIP archive"),
    "wrong meta": (sog_of(means=3), "cannot be read"),
    "new spz": (b"NGSP\x05\0\0\0\x01" + bytes(40), "version 5 of SPZ"),
    "no rows": (header("format ascii 1.0", "element vertex 2", "property float f_dc_0") + b"1\n", "has no x, y, z"),
    "cut ply": (header(_LITTLE, "element vertex 1", "property float x", "property uchar red", "property uchar green",
                       "property uchar blue", "property float y", "property float z"), "ends within element vertex"),
    "two plys": (zipped({"a.ply": header(_LITTLE, "element vertex 1", "property float f_dc_0"),
                         "b.ply": header(_LITTLE, "element vertex 1", "property float f_dc_0")}), "holds 2 files of splats"),
    "no splats": (zipped({"a.txt": b"Hello"}), "a ZIP archive of a.txt"),
}  # fmt: skip


def test_a_file_that_cannot_be_read_says_what_it_is(site: WebSite) -> None:
    """By the words of Python where it is another kind of file."""
    readable = {"model.onnx", "tileset.json"}
    wrong = {
        name: case for name, case in (FOREIGN_FILES | WRONG_FILES).items() if name not in readable
    }
    site.contents.update({f"/wrong/{name}": content for name, (content, _) in wrong.items()})
    results = site.call("splatFiles", [f"/wrong/{name}" for name in wrong])
    for (name, (_, message)), result in zip(wrong.items(), results, strict=True):
        assert message.lower() in result.get("error", "").lower(), (name, result)
        assert result["hint"] or "text that" in result["error"], (name, result)
