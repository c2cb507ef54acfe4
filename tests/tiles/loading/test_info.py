"""`gsgen tiles info` counts what is there."""

import json
import threading
from pathlib import Path

import pytest

from gsgen.tiles.loading.info import describe_tileset
from gsgen.tiles.serving.server import serve_folder
from gsgen.tiles.validation.sketches import explicit_sketch, implicit_sketch
from support.commands import gsgen_here

KEYS = ("tiles", "splats", "leaf_splats", "bytes", "sh_degree", "refine", "levels", "box")


def counted(folder: Path) -> dict[str, int]:
    files = list(folder.rglob("*.glb"))
    return {"files": len(files), "bytes": sum(file.stat().st_size for file in files)}


@pytest.mark.parametrize(("make", "levels"), [(explicit_sketch, 2), (implicit_sketch, 3)])
def test_info_counts_tiles_splats_and_bytes_of_the_files(tmp_path: Path, make, levels: int) -> None:
    path = tmp_path / "tileset.json"
    spec = make()
    spec.write(path)
    completed = gsgen_here("tiles", "info", path, "--json")
    assert completed.code == 0, completed.err
    document = json.loads(completed.out)
    assert set(KEYS) | {"transform"} <= document.keys()
    actual = counted(tmp_path)
    assert sum(level["tiles"] for level in document["levels"]) == actual["files"]
    assert document["bytes"] == sum(level["bytes"] for level in document["levels"])
    assert document["bytes"] == actual["bytes"]
    assert len(document["levels"]) == levels
    assert document["leaf_splats"] == spec.document["metadata"]["properties"]["source_splats"]
    assert document["sh_degree"] == 1
    text = gsgen_here("tiles", "info", path)
    assert f"{document['splats']:,} splats" in text.out


def test_without_metadata_the_headers_say_the_same(tmp_path: Path) -> None:
    spec = explicit_sketch()
    spec.write(tmp_path / "a" / "tileset.json")
    del spec.document["metadata"], spec.document["root"]["metadata"]
    for child in spec.document["root"]["children"]:
        del child["metadata"]
    spec.write(tmp_path / "b" / "tileset.json")
    assert describe_tileset(tmp_path / "a") == describe_tileset(tmp_path / "b")


def test_a_missing_tileset_ends_with_four(tmp_path: Path) -> None:
    completed = gsgen_here("tiles", "info", tmp_path / "none.json")
    assert completed.code == 4
    assert "none.json" in completed.err
    assert "Traceback" not in completed.err


def test_a_served_tileset_is_described_and_validated(tmp_path: Path) -> None:
    explicit_sketch().write(tmp_path / "tileset.json")
    with serve_folder(tmp_path) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            address = f"{server.address}tileset.json"
            assert describe_tileset(address) == describe_tileset(tmp_path)
            completed = gsgen_here("validate", address)
        finally:
            server.shutdown()
            thread.join()
    assert completed.code == 0, completed.err
    assert "23 rules hold" in completed.out


def test_neither_wgpu_nor_scipy_nor_onnx_runtime_is_needed(tmp_path: Path) -> None:
    """Modules that are heavy stay out of info and of the static level."""
    import subprocess
    import sys

    explicit_sketch().write(tmp_path / "tileset.json")
    code = (
        "import sys\n"
        "from gsgen.contract import Level, Settings\n"
        "from gsgen.tiles import describe_tileset, validate\n"
        f"describe_tileset({str(tmp_path)!r})\n"
        f"report = validate({str(tmp_path)!r}, Settings(level=Level.STATIC))\n"
        "assert report.verdict == 'conforms'\n"
        "print(*{'wgpu', 'scipy', 'torch', 'onnxruntime'} & set(sys.modules))"
    )
    completed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (completed.returncode, completed.stdout) == (0, "\n"), (
        completed.stdout + completed.stderr
    )
