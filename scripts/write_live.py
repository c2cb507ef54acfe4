"""Put the browser client and small models into the built site, for its page of live examples.

Run the script after the site was built: .venv/bin/python scripts/write_live.py site
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.formats import Splats, open_splats, write_sog
from gsgen.reference_plugins.people.gauhuman_plugin import build
from gsgen.reference_plugins.samples.files import write_samples
from gsgen.reference_plugins.synthetic import PersonOptions, write_gauhuman, write_motion
from gsgen.runtime.web.onnxruntime_web import ORT_FILES, ort_folder
from gsgen.runtime.web.pages import client_file, client_names
from gsgen.sdk import export
from gsgen.tiles.build.build import build_tileset
from gsgen.tiles.build.engines.opening import open_engine
from gsgen.tiles.build.frame import upright_transform
from gsgen.tiles.build.parameters import BuildParameters
from gsgen.tiles.build.progress import SilentProgress

MODELS = ("garden.sog", "scene.json", "sunflower.onnx", "tiles/tileset.json", "walk.onnx")
"""The models of the page, which lie in the folder ``live`` of the site."""

_SCENE = {
    "gsgen_scene": "1.0",
    "models": [
        "garden.sog",
        {"path": "sunflower.onnx", "translate": [1.2, 0, 0.9], "scale": 0.9},
        {
            "path": "walk.onnx",
            "translate": [-0.9, -0.84, 1.3],
            "rotate": {"axis": [1, 0, 0], "degrees": 180},
            "scale": 0.8,
        },
    ],
    "background": "#b9d3ea",
    "camera": "look-at:-1.0,-1.75,4.7,0.1,-0.75,0",
}


def write_live(site: Path) -> None:
    """Write the client, ONNX Runtime Web and the models into the folder ``live`` of a site."""
    live = site / "live"
    client = live / "gsgen"
    (client / "ort").mkdir(parents=True, exist_ok=True)
    for name in client_names():
        (client / name).write_bytes(client_file(name))
    runtime = ort_folder(None)
    for name in ORT_FILES:
        shutil.copy(runtime / name, client / "ort" / name)
    with tempfile.TemporaryDirectory() as work:
        _write_models(Path(work), live)


def _write_models(work: Path, live: Path) -> None:
    samples = {path.name: path for path in write_samples(work / "samples")}
    garden = open_splats(samples["garden.ply"])
    assert isinstance(garden, Splats)
    write_sog(live / "garden.sog", garden)
    shutil.copy(samples["sunflower.onnx"], live / "sunflower.onnx")
    write_gauhuman(work / "run", PersonOptions(count=4_000, vertices=1_000))
    person = build(work / "run", motion=write_motion(work / "walk.npz", frames=24))
    (live / "scene.json").write_text(json.dumps(_SCENE), "utf-8")
    parameters = BuildParameters(leaf=8_000, transform=upright_transform())
    with open_engine("serial", 1) as engine:
        build_tileset(
            [samples["garden.ply"]],
            live / "tiles",
            parameters,
            engine=engine,
            progress=SilentProgress(),
        )
    export(person, live / "walk.onnx", target="webgpu", settings=Settings(level=Level.STATIC))


if __name__ == "__main__":
    write_live(Path(sys.argv[1]))
