"""Files at addresses are copied with the files beside them, and nothing else is fetched."""

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import onnx
import pytest

from gsgen.contract.errors import InputUnreadable
from gsgen.contract.fetching.errors import FetchFailed, FileMissing, ResponseTooLarge
from gsgen.contract.inputs.local_copies import fetch
from gsgen.contract.model.fetched_inputs import local_file
from gsgen.contract.model.files_beside import require_loadable
from gsgen.contract.rule import Level, Severity
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate
from support.models.small_models import good_rows, save_moving
from support.splat_files import sog_files, zipped
from support.web.file_server import FileServer, Served, file_server


def model_with_weights(folder: Path, location: str = "data/weights.bin") -> dict[str, bytes]:
    """The files of a small model with external weights, by their paths on a server."""
    inside = save_moving(folder / "inside.onnx", good_rows(60))
    proto = onnx.load(inside)
    data = b""
    for tensor in proto.graph.initializer:
        if tensor.dims and np.prod(tensor.dims) > 60:
            entries = {"location": location, "offset": len(data), "length": len(tensor.raw_data)}
            data += tensor.raw_data
            tensor.ClearField("raw_data")
            tensor.data_location = onnx.TensorProto.EXTERNAL
            for key, value in entries.items():
                tensor.external_data.add(key=key, value=str(value))
    assert data
    return {"/m/a.onnx": proto.SerializeToString(), "/m/data/weights.bin": data}


@pytest.fixture
def server() -> Iterator[FileServer]:
    with file_server({}) as server:
        yield server


def test_a_model_comes_with_its_external_weights(server: FileServer, tmp_path: Path) -> None:
    server.files.update(model_with_weights(tmp_path))
    path = local_file(server.address_of("/m/a.onnx"))
    assert require_loadable(path).samefile(path)
    assert server.paths == ["/m/a.onnx", "/m/data/weights.bin"]
    report = validate(server.address_of("/m/a.onnx"), Settings(level=Level.BEHAVIOUR))
    assert [finding for finding in report.findings if finding.severity is Severity.ERROR] == []


def test_a_session_takes_an_address(server: FileServer, tmp_path: Path) -> None:
    pytest.importorskip("gsgen.sdk.binding")
    from gsgen.sdk.binding import FrameSession

    server.files.update(model_with_weights(tmp_path))
    with FrameSession(server.address_of("/m/a.onnx"), provider="cpu") as session:
        assert session.run({"time": 0.5}).gaussians().position.shape == (60, 3)


def test_a_model_whose_weights_are_missing_names_their_address(
    server: FileServer, tmp_path: Path
) -> None:
    files = model_with_weights(tmp_path)
    server.files["/m/a.onnx"] = files["/m/a.onnx"]
    with pytest.raises(FileMissing, match="404") as error:
        local_file(server.address_of("/m/a.onnx"))
    assert error.value.where == server.address_of("/m/data/weights.bin")


def test_weights_beside_a_signed_address_are_refused(server: FileServer, tmp_path: Path) -> None:
    server.files.update(model_with_weights(tmp_path))
    with pytest.raises(InputUnreadable, match="does not follow from one with a query") as error:
        local_file(server.address_of("/m/a.onnx?signature=1"))
    assert "'data/weights.bin'" in error.value.message
    assert server.paths == ["/m/a.onnx?signature=1"]


@pytest.mark.parametrize(
    "location",
    [
        "../weights.bin",
        "/etc/passwd",
        "data/../../weights.bin",
        "..\\weights.bin",
        "a.onnx",
        "./a.onnx",
        "a.onnx/weights.bin",
        "x" * 300,
        "",
    ],
)
def test_weights_that_lead_elsewhere_are_not_fetched(
    location: str, server: FileServer, tmp_path: Path
) -> None:
    server.files.update(model_with_weights(tmp_path, location))
    path = local_file(server.address_of("/m/a.onnx"))
    assert server.paths == ["/m/a.onnx"]
    with pytest.raises(InputUnreadable):
        require_loadable(path)


@pytest.mark.parametrize("location", ["http://other.example/w", "?x=1", "a#b", "//other.example/w"])
def test_weights_named_like_an_address_stay_on_the_server(
    location: str, server: FileServer, tmp_path: Path
) -> None:
    server.files.update(model_with_weights(tmp_path, location))
    with pytest.raises(InputUnreadable):
        require_loadable(local_file(server.address_of("/m/a.onnx")))
    assert all(path.startswith("/m/") for path in server.paths)


def test_more_files_than_the_limit_are_not_fetched(server: FileServer, tmp_path: Path) -> None:
    names = {"files": [f"{index}.webp" for index in range(300)]}
    server.files["/meta.json"] = json.dumps({"means": names, "scales": {}}).encode()
    with pytest.raises(InputUnreadable, match="names 300 files beside it"):
        local_file(server.address_of("/meta.json"))
    assert server.paths == ["/meta.json"]


def test_a_sog_comes_with_its_textures(server: FileServer) -> None:
    from gsgen.formats import open_splats

    server.files.update({f"/s/{name}": content for name, content in sog_files().items()})
    assert len(open_splats(server.address_of("/s/meta.json"))) == 10


@pytest.mark.parametrize(
    ("name", "content", "title"),
    [
        ("lod-meta.json", {"lodLevels": 1}, "streamed SOG"),
        ("scene.json", {"gsgen_scene": 1}, "scene file"),
    ],
)
def test_a_file_of_many_folders_says_that_it_is_not_fetched(
    name: str, content: dict[str, int], title: str, server: FileServer
) -> None:
    server.files[f"/{name}"] = json.dumps(content).encode()
    with pytest.raises(InputUnreadable, match=title) as error:
        local_file(server.address_of(f"/{name}"))
    assert error.value.hint == "Download its folder, and name the file there."


def test_a_tileset_of_a_store_says_where_it_is_streamed_from(tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    (tmp_path / "tileset.json").write_text('{"asset": {"version": "1.1"}, "root": {}}')
    with pytest.raises(InputUnreadable, match="streamed from https and http alone"):
        local_file(f"file://{tmp_path}/tileset.json")


def test_a_model_without_a_suffix_gets_it(server: FileServer, tmp_path: Path) -> None:
    server.files["/download"] = save_moving(tmp_path / "a.onnx", good_rows(3)).read_bytes()
    assert local_file(server.address_of("/download?id=5")).name == "download.onnx"


def test_the_budget_is_that_of_all_files(server: FileServer, tmp_path: Path) -> None:
    files = sog_files()
    server.files.update({f"/{name}": content for name, content in files.items()})
    total = sum(map(len, files.values()))
    folder = tmp_path / "copy"
    folder.mkdir()
    with pytest.raises(ResponseTooLarge):
        fetch(server.address_of("/meta.json"), folder, max_bytes=total - 1)


def test_a_file_that_declares_too_many_bytes_is_refused_at_once(server: FileServer) -> None:
    server.files["/a.ply"] = Served(b"ply", headers={"Content-Length": str(1 << 50)})
    with pytest.raises(ResponseTooLarge, match="expected 17,179,869,184 bytes or fewer"):
        local_file(server.address_of("/a.ply"))


def test_progress_tells_the_size(server: FileServer) -> None:
    server.files["/a.bin"] = bytes(1000)
    calls: list[tuple[str, int, int | None]] = []
    local_file(server.address_of("/a.bin"), on_bytes=lambda *call: calls.append(call))
    assert calls[0][1:] == (0, None)
    assert calls[-1] == (server.address_of("/a.bin"), 1000, 1000)


def test_object_stores_are_read_with_their_neighbours(tmp_path: Path) -> None:
    fsspec = pytest.importorskip("fsspec")
    store = fsspec.filesystem("memory")
    for name, content in model_with_weights(tmp_path).items():
        store.pipe(name, content)
    path = local_file("memory://m/a.onnx")
    require_loadable(path)
    assert (
        local_file(f"file://{tmp_path}/inside.onnx").read_bytes()
        == (tmp_path / "inside.onnx").read_bytes()
    )
    with pytest.raises(FileMissing, match="no such file") as error:
        local_file("memory://m/b.onnx")
    assert error.value.where == "memory://m/b.onnx"


def test_a_store_without_its_package_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("fsspec")
    for scheme, package in {"s3": "s3fs", "gs": "gcsfs", "az": "adlfs"}.items():
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(InputUnreadable, match=f"needs {package}") as error:
            local_file(f"{scheme}://bucket/a.ply")
        assert error.value.hint == f"pip install 'gsgen[stores]' {package}"


def test_without_fsspec_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec", None)
    with pytest.raises(InputUnreadable, match="fsspec, which is not installed") as error:
        local_file("s3://bucket/a.ply")
    assert error.value.hint == "pip install 'gsgen[stores]'"


@pytest.mark.parametrize(
    "address", ["gopher://a/b.ply", "simplecache::s3://a/b.ply", "file:///a::b/c.ply"]
)
def test_an_unknown_scheme_is_refused(address: str) -> None:
    pytest.importorskip("fsspec")
    with pytest.raises((InputUnreadable, FetchFailed)):
        require_loadable(local_file(address))


MESH = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


def test_an_archive_of_one_mesh_is_unpacked_with_its_materials(tmp_path: Path) -> None:
    archive = tmp_path / "a.zip"
    members = {"m/a.obj": MESH, "m/a.mtl": b"newmtl a\n", "__MACOSX/._a.obj": b"x", "m/b.txt": b"b"}
    archive.write_bytes(zipped(members))
    path = local_file(archive)
    assert path.read_bytes() == MESH
    assert (path.parent / "a.mtl").read_bytes() == b"newmtl a\n"
    assert not (path.parents[1] / "__MACOSX").exists()


def test_an_archive_of_one_model_is_validated(tmp_path: Path) -> None:
    archive = tmp_path / "a.zip"
    files = {name.lstrip("/"): content for name, content in model_with_weights(tmp_path).items()}
    archive.write_bytes(zipped(files))
    report = validate(archive, Settings(level=Level.VALUES))
    assert [finding for finding in report.findings if finding.severity is Severity.ERROR] == []


@pytest.mark.parametrize(
    "name", ["../b.txt", "/tmp/b.txt", "a/../../b.txt", "..\\b.txt", "a.obj/b"]
)
def test_no_member_of_an_archive_leaves_the_folder(name: str, tmp_path: Path) -> None:
    archive = tmp_path / "a.zip"
    archive.write_bytes(zipped({"a.obj": MESH, name: b"escaped"}))
    if name == "a.obj/b":
        with pytest.raises(InputUnreadable, match="cannot be unpacked"):
            local_file(archive)
        return
    path = local_file(archive)
    assert [file.name for file in path.parent.iterdir()] == ["a.obj"]
    assert not (path.parent.parent / "b.txt").exists()


@pytest.mark.parametrize("members", [{"a.obj": MESH, "b.obj": MESH}, {"a.txt": b"text"}, {}])
def test_other_archives_stay_packed(members: dict[str, bytes], tmp_path: Path) -> None:
    archive = tmp_path / "a.zip"
    archive.write_bytes(zipped(members))
    assert local_file(archive) == archive


def test_an_archive_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    archive = tmp_path / "a.zip"
    content = bytearray(zipped({"a.obj": MESH, "b.bin": b"b", "c.bin": b"c"}))
    for name in (b"b.bin", b"c.bin"):
        entry = content.rindex(name) - 46  # in the list of members
        content[entry + 24 : entry + 28] = (3 << 30).to_bytes(4, "little")  # the unpacked size
    archive.write_bytes(content)
    with pytest.raises(InputUnreadable, match="unpacks to 6,442,450,"):
        local_file(archive)
