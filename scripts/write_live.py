"""Put the browser client and small models into the built site, for its live examples.

Beside them, the drop page as one file that works from disk.

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
from gsgen.runtime.web.pages import ModelView, client_file, client_names, single_file_page
from gsgen.runtime.web.three_js import THREE
from gsgen.sdk import export
from gsgen.tiles.build.build import build_tileset
from gsgen.tiles.build.engines.opening import open_engine
from gsgen.tiles.build.frame import upright_transform
from gsgen.tiles.build.parameters import BuildParameters
from gsgen.tiles.build.progress import SilentProgress

_DOCS = Path(__file__).parents[1] / "docs"
_DROP_STYLE = """<style>
main { display: block; max-width: 60rem; margin: auto }
gsgen-scene { display: block; height: 60vh }
.drop-field { border: 2px dashed #9aa0a6; padding: 2rem }
td, th { text-align: left; vertical-align: top; padding: .2rem .6rem; overflow-wrap: anywhere }
[hidden] { display: none !important }
</style>"""
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
    client.mkdir(parents=True, exist_ok=True)
    for name in client_names():
        (client / name).write_bytes(client_file(name))
    libraries = {"ort": (ort_folder(None), ORT_FILES), "three": (THREE.located(None), THREE.names)}
    for library, (folder, names) in libraries.items():
        for name in names:
            (client / library / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(folder / name, client / library / name)
    page = drop_page(libraries["ort"][0], libraries["three"][0])
    (live / "drop.html").write_text(page, "utf-8")
    with tempfile.TemporaryDirectory() as work:
        _write_models(Path(work), live)


def drop_page(ort: Path | None, three: Path | None) -> str:
    """Return the drop page as one HTML file, which needs no site and no network."""
    text = (_DOCS / "drop.md").read_text("utf-8")
    body = text.partition("<!-- drop page -->")[2].partition("<!-- end of drop page -->")[0]
    script = (_DOCS / "assets" / "drop.js").read_text("utf-8")
    page = single_file_page([], ModelView(), ort, three=three)
    page = page.replace("<title></title>", f"<title>gsgen: drop a file</title>\n{_DROP_STYLE}")
    start, _, end = page.partition("<main>")
    body = body.replace(' data-root="../"', "")
    scripts = (
        f'<script type="module">{script}</script><script type="module">import "gsgen/scene.js";'
    )
    end = end.replace('<script type="module">import "gsgen/gsgen.js";', scripts)
    return f"{start}<main>\n<h1>Drop a file</h1>{body}{end}"


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
