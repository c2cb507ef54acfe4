"""Splat files at addresses are read as those on disk, and texts name them by their addresses."""

import json
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

from gsgen.contract.errors import GsgenError
from gsgen.contract.fetching.errors import FileMissing
from gsgen.formats import FormatError, FormatWarning, open_splats, read_sog, write_sog
from gsgen.formats.codecs import CODECS, codec_named
from support.commands import gsgen_here
from support.splat_files import assert_near, samples, scene
from support.web.file_server import FileServer, file_server

COPY_MARKS = ("/tmp", ".part", "gsgen-")
"""Parts of the paths of temporary copies."""


@pytest.fixture
def server(tmp_path: Path) -> Iterator[FileServer]:
    (tmp_path / "served").mkdir()
    write_sog(tmp_path / "served" / "meta.json", scene(20, 1))
    files = {f"/sog/{file.name}": file.read_bytes() for file in (tmp_path / "served").iterdir()}
    with file_server(files) as server:
        yield server


def opened(path: str) -> tuple[object, list[str]]:
    """The content of a file, or its error, and all texts that tell of it."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            content: object = open_splats(path, drop_invalid=True)
        except GsgenError as error:
            content = error
    notes = [str(warning.message) for warning in caught if warning.category is FormatWarning]
    return content, [*notes, *([str(content)] if isinstance(content, GsgenError) else [])]


def damaged(content: bytes) -> Iterator[bytes]:
    """A file whole, cut, and with other bytes at its beginning, in its middle and at its end."""
    yield content
    yield from (content[: len(content) * part // 8] for part in range(8))
    for middle in (0, 5, len(content) // 2, max(0, len(content) - 40)):
        yield content[:middle] + bytes(range(40)) + content[middle + 40 :]


@pytest.mark.parametrize("name", ["ply", "compressed-ply", "spz", "splat", "glb", "ksplat", "sog"])
def test_damaged_file_at_an_address_is_told_of_by_the_address(
    server: FileServer, tmp_path: Path, name: str
) -> None:
    suffix = codec_named(name).suffixes[0]
    for number, sample in enumerate(samples(tmp_path)[name]):
        for index, content in enumerate(damaged(sample)):
            path = f"/{number}-{index}{suffix}"
            server.files[path] = content
            result, texts = opened(server.address_of(path) + "?token=secret")
            assert not any(mark in text for text in texts for mark in COPY_MARKS)
            assert not any("secret" in text for text in texts)
            if isinstance(result, GsgenError):
                assert texts[-1].startswith(server.address_of(path))
            (tmp_path / "copy").mkdir(exist_ok=True)
            local = tmp_path / "copy" / path[1:]
            local.write_bytes(content)
            assert type(opened(str(local))[0]) is type(result)


def test_names_of_formats_cover_the_table() -> None:
    by_zip = {"checkpoint", "npz"}
    tested = {"ply", "compressed-ply", "spz", "splat", "glb", "ksplat", "sog"}
    assert {codec.name for codec in CODECS} == by_zip | tested


def test_unbundled_sog_at_an_address_is_read_with_its_images(
    server: FileServer, tmp_path: Path
) -> None:
    expected = read_sog(tmp_path / "served" / "meta.json")
    assert_near(open_splats(server.address_of("/sog/meta.json")), expected)
    server.files["/sog/other.json"] = server.files["/sog/meta.json"]
    assert_near(open_splats(server.address_of("/sog/other.json")), expected)


def test_gltf_at_an_address_is_read_with_its_buffers(server: FileServer, tmp_path: Path) -> None:
    document, content = gltf_beside_bin(tmp_path)
    server.files["/m/a.gltf"] = json.dumps(document).encode()
    server.files["/m/data/a.bin"] = content
    assert_near(open_splats(server.address_of("/m/a.gltf")), scene(12, 1))
    server.files["/m/data/a.bin"] = content[:100]
    error, (text,) = opened(server.address_of("/m/a.gltf"))
    assert isinstance(error, FormatError)
    assert text.startswith(server.address_of("/m/a.gltf"))


def gltf_beside_bin(folder: Path) -> tuple[dict[str, object], bytes]:
    """A glTF document of splats, and its buffer, for ``data/a.bin``."""
    from gsgen.formats.glb.container import parse
    from gsgen.formats.glb.glb import write_glb

    write_glb(folder / "a.glb", scene(12, 1))
    whole = (folder / "a.glb").read_bytes()
    size = int.from_bytes(whole[12:16], "little")
    document = json.loads(whole[20 : 20 + size])
    document["buffers"][0]["uri"] = "data/a.bin"
    assert parse(whole)
    return document, whole[20 + size + 8 :]


@pytest.mark.parametrize("image", range(3))
@pytest.mark.parametrize("content", [b"", b"RIFF", None])
def test_damaged_image_of_a_sog_at_an_address_is_told_of_by_the_address(
    server: FileServer, image: int, content: bytes | None
) -> None:
    path = sorted(path for path in server.files if path.endswith(".webp"))[image]
    if content is None:
        del server.files[path]
    else:
        server.files[path] = content
    error, (text,) = opened(server.address_of("/sog/meta.json"))
    assert isinstance(error, GsgenError)
    assert text.startswith(server.address_of("/sog/"))
    assert not any(mark in text for mark in COPY_MARKS)


@pytest.mark.parametrize(
    "name",
    ["", "..", "a/../..", "/etc/passwd", "a\\b", "a\0b", "\x1b[31m", "x" * 300, "\ud800.webp"],
)
def test_sog_at_an_address_with_an_unusual_image_name_is_refused(
    server: FileServer, tmp_path: Path, name: str
) -> None:
    document = json.loads((tmp_path / "served" / "meta.json").read_bytes())
    document["means"]["files"][0] = name
    server.files["/sog/meta.json"] = json.dumps(document).encode()
    error, (text,) = opened(server.address_of("/sog/meta.json"))
    assert isinstance(error, GsgenError)
    assert text.startswith(server.address_of("/sog/"))
    assert text.replace("\n", " ").isprintable()
    assert not any(mark in text for mark in COPY_MARKS)


def test_a_path_object_of_an_address_is_read(server: FileServer, tmp_path: Path) -> None:
    server.files["/a b.ply"] = server.files["/a.ply"] = samples(tmp_path)["ply"][1]
    assert_near(open_splats(Path(server.address_of("/a.ply"))), scene(12, 1, antialiased=True))


def test_a_file_that_the_server_lacks_is_missing(server: FileServer, tmp_path: Path) -> None:
    address = server.address_of("/none.ply")
    with pytest.raises(FileMissing, match="404"):
        open_splats(address)
    completed = gsgen_here("convert", address, tmp_path / "b.ply")
    assert completed.code == 4
    assert f"{address}: the server answers 404" in completed.err


def test_a_file_at_an_address_is_converted_with_both_sizes(
    server: FileServer, tmp_path: Path
) -> None:
    content = samples(tmp_path)["ply"][1]
    server.files["/a%20b.ply"] = content
    completed = gsgen_here("convert", server.address_of("/a%20b.ply"), tmp_path / "b.ply")
    assert completed.code == 0, completed.err
    assert "ply, 0.00 MiB → 0.00 MiB\n" in completed.out
    assert_near(open_splats(tmp_path / "b.ply"), scene(12, 1, antialiased=True))
