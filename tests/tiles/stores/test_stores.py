"""Folders, archives and servers give the same bytes, and say what they cannot give."""

import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.fetching import client
from gsgen.tiles.errors import ContentMissing, StoreUnavailable, TilesetInvalid
from gsgen.tiles.loading.leaves import read_leaves
from gsgen.tiles.serving.faults import FailureRule, NetworkFaults, parse_failure
from gsgen.tiles.serving.server import serve_folder
from gsgen.tiles.stores.folder_store import FolderStore
from gsgen.tiles.stores.http_store import HttpStore
from gsgen.tiles.stores.opening import open_store
from gsgen.tiles.stores.ranged_file import RangedFile
from gsgen.tiles.stores.store import Store
from gsgen.tiles.stores.zip_store import INDEX_NAME, ZipStore, write_archive
from gsgen.tiles.validation.sketches import explicit_sketch, implicit_sketch
from support.commands import gsgen_here

BODY = bytes(np.random.default_rng(0).integers(0, 256, 100_000, dtype=np.uint8))


@contextmanager
def served(folder: Path, faults: NetworkFaults | None = None) -> Iterator[str]:
    lines: list[str] = []
    with serve_folder(folder, faults=faults, log=lines.append) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server.address
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    files_folder = tmp_path / "files"
    (files_folder / "t").mkdir(parents=True)
    (files_folder / "t" / "a b.glb").write_bytes(BODY)
    (files_folder / "empty.bin").write_bytes(b"")
    (files_folder / "tileset.json").write_bytes(b"{}")
    (tmp_path / "secret.txt").write_bytes(b"not for you")
    return files_folder


@pytest.fixture(params=["folder", "zip", "deflated", "http"])
def store(request: pytest.FixtureRequest, folder: Path) -> Iterator[Store]:
    if request.param == "folder":
        yield FolderStore(folder)
    elif request.param == "zip":
        archive = folder.parent / "a.3tz"
        write_archive(folder, archive)
        with ZipStore(archive) as opened:
            yield opened
    elif request.param == "deflated":
        archive = folder.parent / "b.3tz"
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
            for file in sorted(folder.rglob("*")):
                packed.write(file, file.relative_to(folder).as_posix())
        with ZipStore(archive) as opened:
            yield opened
    else:
        with served(folder) as address, HttpStore(f"{address}tileset.json") as opened:
            yield opened


def test_any_range_is_that_of_the_bytes(store: Store) -> None:
    assert store.size("t/a b.glb") == len(BODY)
    assert store.read("t/a b.glb") == BODY
    rng = np.random.default_rng(1)
    for _ in range(20):
        start, size = int(rng.integers(0, len(BODY) + 10)), int(rng.integers(0, 3000))
        assert store.read("t/a b.glb", start=start, size=size) == BODY[start : start + size]
    assert store.read("t/a b.glb", start=99_990) == BODY[99_990:]
    assert store.read("t/a b.glb", size=0) == b""
    assert store.read("empty.bin") == b""


def test_a_read_at_the_end_of_a_file_asks_the_store_for_nothing(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = FolderStore(folder)
    file = RangedFile(store, "t/a b.glb")
    size = len(BODY)
    requests: list[int] = []
    read = FolderStore.read

    def counted(self: FolderStore, path: str, *, start: int, size: int) -> bytes:
        requests.append(size)
        return read(self, path, start=start, size=size)

    monkeypatch.setattr(FolderStore, "read", counted)
    assert file.read_at(size - 3, 10) == BODY[-3:]
    assert [file.read_at(size, 10), file.read_at(size + 9, 10), file.read_at(0, 0)] == [b""] * 3
    assert requests == [3]


def test_missing_or_oversized_file_is_named_in_the_error(store: Store) -> None:
    with pytest.raises(ContentMissing, match=r"nowhere\.glb"):
        store.read("nowhere.glb")
    with pytest.raises(ContentMissing):
        store.size("nowhere.glb")
    with pytest.raises(ContentMissing):
        store.read("t")
    with pytest.raises(TilesetInvalid, match="bytes"):
        store.read("t/a b.glb", limit=5000)
    with pytest.raises(TilesetInvalid):
        store.read("../secret.txt")


def test_a_link_does_not_lead_out(folder: Path) -> None:
    (folder / "link.txt").symlink_to(folder.parent / "secret.txt")
    with pytest.raises(TilesetInvalid, match="link"):
        FolderStore(folder).read("link.txt")


@pytest.mark.parametrize("make", [explicit_sketch, implicit_sketch])
def test_a_tileset_is_the_same_from_every_store(tmp_path: Path, make) -> None:
    path = tmp_path / "town" / "tileset.json"
    path.parent.mkdir()
    make().write(path)
    archive = tmp_path / "town.3tz"
    write_archive(path.parent, archive)
    leaves = read_leaves(path)
    assert np.array_equal(read_leaves(archive).position, leaves.position)
    assert np.array_equal(read_leaves(path.parent).sh, leaves.sh)
    with served(path.parent) as address:
        actual = read_leaves(f"{address}tileset.json")
        served_archive = Path(f"{address}town.3tz")  # as the command line hands it over
        archive.rename(path.parent / "town.3tz")
        packed = read_leaves(served_archive)
        with pytest.raises(ContentMissing, match="404"):
            open_store(f"{address}none.3tz")
    assert np.array_equal(actual.position, leaves.position)
    assert np.array_equal(packed.position, leaves.position)


def test_the_command_packs_a_folder(tmp_path: Path) -> None:
    path = tmp_path / "town" / "tileset.json"
    path.parent.mkdir()
    explicit_sketch().write(path)
    archive = tmp_path / "town.3tz"
    completed = gsgen_here("tiles", "pack", path.parent, "-o", archive)
    assert completed.code == 0, completed.err
    files = [file for file in path.parent.rglob("*") if file.is_file()]
    assert f"town.3tz: {len(files)} files" in completed.out
    assert np.array_equal(read_leaves(archive).position, read_leaves(path).position)
    empty = gsgen_here("tiles", "pack", tmp_path, "-o", archive)
    assert (empty.code, "no tileset.json" in empty.err) == (4, True)
    refused = gsgen_here("tiles", "pack", path.parent, "-o", tmp_path / "none" / "x.3tz")
    assert refused.code == 2
    assert "Traceback" not in refused.err


def test_an_archive_is_always_the_same_and_indexed(folder: Path, tmp_path: Path) -> None:
    first, second = tmp_path / "1.3tz", tmp_path / "2.3tz"
    write_archive(folder, first)
    write_archive(folder, second)
    assert first.read_bytes() == second.read_bytes()
    with zipfile.ZipFile(first) as packed:
        assert packed.namelist()[-1] == INDEX_NAME
        assert packed.testzip() is None


@pytest.mark.parametrize("damage", ["index", "cut", "text", "member"])
def test_a_damaged_archive_is_refused(folder: Path, tmp_path: Path, damage: str) -> None:
    archive = tmp_path / "a.3tz"
    write_archive(folder, archive)
    data = bytearray(archive.read_bytes())
    with zipfile.ZipFile(archive) as packed:
        index = packed.getinfo(INDEX_NAME)
        member = packed.getinfo("t/a b.glb")
    if damage == "index":
        data[index.header_offset + 30 + len(INDEX_NAME) + 17] ^= 1
    elif damage == "cut":
        del data[-30:]
    elif damage == "text":
        data[:] = b"hello"
    else:
        data[member.header_offset] ^= 255
    archive.write_bytes(data)
    with pytest.raises(TilesetInvalid), ZipStore(archive) as opened:
        opened.read("t/a b.glb")


def test_errors_of_a_server_are_tried_again(folder: Path) -> None:
    """A seed whose first answer is 503 and whose second is not."""
    failing = (FailureRule(503, 0.5),)
    seed = next(
        seed
        for seed in range(100)
        if [NetworkFaults(failures=failing, seed=seed).choose()] == [503]
        and _second(failing, seed) is None
    )
    faults = NetworkFaults(failures=failing, seed=seed)
    with served(folder, faults) as address, HttpStore(f"{address}x.json") as store:
        assert store.read("t/a b.glb") == BODY


def _second(failing: tuple[FailureRule, ...], seed: int) -> object:
    faults = NetworkFaults(failures=failing, seed=seed)
    faults.choose()
    return faults.choose()


@pytest.mark.parametrize("failure", [404, 500, "cut"])
def test_a_server_that_always_fails_is_named(
    folder: Path, monkeypatch: pytest.MonkeyPatch, failure
) -> None:
    monkeypatch.setattr(client, "_BACKOFF_SECONDS", 0.01)
    faults = NetworkFaults(failures=(FailureRule(failure, 1.0),))
    expected = ContentMissing if failure == 404 else StoreUnavailable
    with (
        served(folder, faults) as address,
        HttpStore(f"{address}x.json") as store,
        pytest.raises(expected) as caught,
    ):
        store.read("t/a b.glb")
    assert "a b.glb" in str(caught.value)


def test_refused_connection_is_reported_as_no_answer() -> None:
    with (
        HttpStore("http://127.0.0.1:9/x.json", timeout=0.2) as store,
        pytest.raises(StoreUnavailable, match="the server gives no answer"),
    ):
        store.read("tileset.json")


def test_rate_and_latency_are_those_asked_for() -> None:
    """A link of 1000 B/s on a clock of our own: waits are the sums of what was sent."""
    now, waits = [0.0], []

    def sleep(seconds: float) -> None:
        waits.append(seconds)
        now[0] += seconds

    faults = NetworkFaults(bytes_per_second=1000.0, latency=0.25, clock=lambda: now[0], sleep=sleep)
    faults.wait_to_begin()
    for size in (500, 1500, 0):
        faults.wait_to_send(size)
    assert waits == [0.25, 0.5, 1.5, 0.0]


def test_shares_of_failures_are_those_asked_for() -> None:
    faults = NetworkFaults(failures=(parse_failure("404:0.1"), parse_failure("cut:0.3")))
    drawn = [faults.choose() for _ in range(20_000)]
    assert abs(drawn.count(404) / len(drawn) - 0.1) < 0.01
    assert abs(drawn.count("cut") / len(drawn) - 0.3) < 0.015


@pytest.mark.parametrize("text", ["", "404", "200:0.1", "404:2", "cut:x", "404:1.0.0", "::"])
def test_invalid_failure_option_is_refused(text: str) -> None:
    with pytest.raises(ConfigInvalid):
        parse_failure(text)


def test_path_or_address_gives_store_and_index(tmp_path: Path) -> None:
    store, index = open_store("https:/example.org/a/b.json")  # as a Path has it
    assert (store.name, index) == ("https://example.org/a", "b.json")
    store.close()
    store, index = open_store(tmp_path / "x" / "other.json")
    assert (store.name, index) == (str(tmp_path / "x"), "other.json")


@pytest.mark.parametrize(
    "address", ["http://[::1/a.ply", "http://", "https://a:b@c/x.3tz", "http://a:x/"]
)
def test_malformed_address_is_named(address: str, tmp_path: Path) -> None:
    completed = gsgen_here("convert", address, tmp_path / "a.ply")
    assert completed.code == 4, completed.err
    assert "is not a web address" in completed.err
    assert "Traceback" not in completed.err


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_an_archived_file_with_another_crc_is_refused(tmp_path: Path, compression: int) -> None:
    path = tmp_path / "a.3tz"
    with zipfile.ZipFile(path, "w", compression) as archive:
        archive.writestr("a.bin", bytes(range(256)))
    content = bytearray(path.read_bytes())
    directory = content.index(b"PK\x01\x02")
    content[directory + 16] ^= 1  # a byte of the CRC
    path.write_bytes(content)
    with ZipStore(path) as opened:
        assert opened.read("a.bin", start=3, size=2) == b"\x03\x04"
        with pytest.raises(TilesetInvalid, match="CRC-32"):
            opened.read("a.bin")
