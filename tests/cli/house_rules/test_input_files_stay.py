"""No command overwrites a file that it reads: it refuses, and the file keeps its bytes."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.conformance.fixtures import find
from gsgen.formats import write_ply
from support.commands import gsgen_here
from support.splat_files import scene

CAMERA = '[{"view": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]], "fx": 40, "fy": 40, \
"cx": 16, "cy": 12, "width": 32, "height": 24}]'
# What is typed, and the input file that it would overwrite.
OVERWRITING = [
    ("export html src.ply -o src.ply", "src.ply"),
    ("export html drift.onnx src.ply -o ./src.ply", "src.ply"),
    ("convert src.ply out.spz --histograms src.ply", "src.ply"),
    ("export static src.ply -o out.onnx --report src.ply", "src.ply"),
    ("export sequence src.ply src.ply -o out.onnx --report src.ply", "src.ply"),
    ("render src.ply -o src.ply", "src.ply"),
    ("render d.png -o d.png", "d.png"),
    ("render src.ply d.png -o d.png", "d.png"),
    ("render avatar.onnx --pose n.npy -o n.npy", "n.npy"),
    ("render avatar.onnx --pose pose=n.npy -o n.npy", "n.npy"),
    ("render avatar.onnx --pose poses -o poses/1.npy", "poses/1.npy"),
    ("render avatar.onnx --input pose=n.npy -o n.npy", "n.npy"),
    ("render src.ply --post d.png -o d.png", "d.png"),
    ("render src.ply --camera cameras.json#0 -o cameras.json", "cameras.json"),
    ("render scene.json -o src.ply", "src.ply"),
    ("render frames/frame_0001.png -o frames", "frames/frame_0001.png"),
    ("render wall.obj -o stone.png", "stone.png"),
    ("bench-render src.ply --camera cameras.json -o cameras.json", "cameras.json"),
    ("bench-render scene.json -o src.ply", "src.ply"),
    ("bake drift.onnx --camera cameras.json --format ply -o cameras.json", "cameras.json"),
    ("bake drift.onnx --input time=1.npy --format ply -o %d.npy", "1.npy"),
    ("references drift.onnx --camera cameras.json -o cameras.json", "cameras.json"),
    ("references drift.onnx --from frames --cameras cameras.json -o cameras.json", "cameras.json"),
    ("fix drift.onnx --manifest cameras.json -o cameras.json", "cameras.json"),
    ("validate drift.onnx --baseline cameras.json -o cameras.json", "cameras.json"),
    ("card drift.onnx -o drift.onnx", "drift.onnx"),
    ("bench drift.onnx -o drift.onnx", "drift.onnx"),
    ("tiles pack tiles -o tiles/tileset.json", "tiles/tileset.json"),
    ("tiles score tiles src.ply -o src.ply", "src.ply"),
    ("tiles simulate tiles --path path.csv --network path.csv --plot path.csv", "path.csv"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    for name in ("frames", "poses", "tiles"):
        (folder / name).mkdir()
    write_ply(folder / "src.ply", scene(20, 0))
    for name in ("drift", "avatar"):
        find(name).write(folder).rename(folder / f"{name}.onnx")
    for name in ("n.npy", "1.npy", "poses/1.npy"):
        np.save(folder / name, np.linspace(0, 1, 2, dtype=np.float32))
    for name in ("d.png", "stone.png", "frames/frame_0001.png"):
        Image.new("RGB", (4, 4)).save(folder / name)
    texts = {
        "cameras.json": CAMERA,
        "scene.json": '{"models": ["src.ply"]}',
        "wall.obj": "mtllib wall.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n",
        "wall.mtl": "newmtl a\nmap_Kd stone.png\n",
        "path.csv": "t,mbps\n0,1\n",
        "tiles/tileset.json": "{}",
    }
    for name, text in texts.items():
        (folder / name).write_text(text, "utf-8")
    return folder


@pytest.mark.parametrize(("line", "name"), OVERWRITING, ids=[line for line, _ in OVERWRITING])
def test_an_input_file_keeps_its_bytes(folder: Path, line: str, name: str) -> None:
    files = [path for path in folder.rglob("*") if path.is_file()]
    before = {path: path.read_bytes() for path in files}
    completed = gsgen_here(*line.split(), cwd=folder)
    assert completed.code == 2, completed
    assert f"{name}: is also an input file, which would be overwritten" in completed.err
    assert {path for path in folder.rglob("*") if path.is_file()} == set(files)
    assert {path: path.read_bytes() for path in files} == before


@pytest.mark.parametrize("output", ["page.ply", "page", "frames"])
def test_page_output_requires_an_html_suffix(folder: Path, output: str) -> None:
    completed = gsgen_here("export", "html", "src.ply", "-o", output, cwd=folder)
    assert completed.code == 2
    assert ("frames/page.html" if output == "frames" else "expected .html or .htm") in completed.err
    assert not (folder / output).is_file()
