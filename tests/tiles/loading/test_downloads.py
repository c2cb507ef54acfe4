"""Files of splats on a web server."""

import json
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import FormatError, read_sog, write_ply, write_sog
from gsgen.tiles.errors import ContentMissing
from gsgen.tiles.loading.leaves import open_splats
from gsgen.tiles.serving.server import serve_folder
from support.commands import gsgen_here
from support.splat_files import assert_near, scene


@pytest.fixture
def address(tmp_path: Path) -> Iterator[str]:
    folder = tmp_path / "served"
    folder.mkdir()
    write_ply(folder / "a.ply", scene(20, 1))
    write_sog(folder / "meta.json", scene(20, 1))
    (folder / "bad.ply").write_bytes(b"ply\nnonsense\nend_header\n")
    with serve_folder(folder) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server.address.rstrip("/")
        server.shutdown()
        thread.join()


def test_a_file_on_a_server_is_read(address: str, tmp_path: Path) -> None:
    assert_near(open_splats(f"{address}/a.ply"), scene(20, 1))
    assert_near(open_splats(Path(f"{address}/a.ply")), scene(20, 1))
    unbundled = open_splats(f"{address}/meta.json")
    assert_near(unbundled, read_sog(tmp_path / "served" / "meta.json"))


def test_a_file_on_a_server_is_converted(address: str, tmp_path: Path) -> None:
    completed = gsgen_here("convert", f"{address}/a.ply", tmp_path / "b.ply")
    assert completed.code == 0, completed.err
    assert "ply, 0.00 MiB\n" in completed.out  # the size of what was written alone
    np.testing.assert_array_equal(open_splats(tmp_path / "b.ply").position, scene(20, 1).position)


def test_faults_name_the_address(address: str, tmp_path: Path) -> None:
    with pytest.raises(FormatError) as caught:
        open_splats(f"{address}/bad.ply")
    assert caught.value.path == f"{address}/bad.ply"
    with pytest.raises(ContentMissing, match="404"):
        open_splats(f"{address}/none.ply")
    completed = gsgen_here("convert", f"{address}/none.ply", tmp_path / "b.ply")
    assert completed.code == 4
    assert "404" in completed.err


def test_address_with_a_quoted_name_is_read(address: str, tmp_path: Path) -> None:
    (tmp_path / "served" / "a b.ply").write_bytes((tmp_path / "served" / "a.ply").read_bytes())
    assert_near(open_splats(f"{address}/a%20b.ply"), scene(20, 1))


@pytest.mark.parametrize(
    "name",
    ["", "..", "a/../..", "/etc/passwd", "a\\b", "a\0b", "\x1b[31m", "x" * 300, "\ud800.webp"],
)
def test_remote_sog_with_an_unusual_image_name_is_refused(
    address: str, tmp_path: Path, name: str
) -> None:
    meta = tmp_path / "served" / "meta.json"
    document = json.loads(meta.read_bytes())
    document["means"]["files"][0] = name
    meta.write_text(json.dumps(document))
    with pytest.raises(FormatError) as caught:
        open_splats(f"{address}/meta.json")
    assert caught.value.path == f"{address}/meta.json"
    assert str(caught.value).replace("\n", " ").isprintable()
