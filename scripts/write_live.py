"""Put the browser client and small models into the built site, for its page of live examples.

Run the script after the site was built: .venv/bin/python scripts/write_live.py site
"""

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

MODELS = ("garden.sog", "sunflower.onnx", "walk.onnx")
"""The models of the page, which lie in the folder ``live`` of the site."""


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
    export(person, live / "walk.onnx", target="webgpu", settings=Settings(level=Level.STATIC))


if __name__ == "__main__":
    write_live(Path(sys.argv[1]))
