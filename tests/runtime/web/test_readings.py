"""Files that several elements open, read once: who has left hears nothing more of them."""

import subprocess
from pathlib import Path

from gsgen.formats import write_ply
from gsgen.reference_plugins.writing.knot import torus_knot
from support.web.packages import package
from support.web.pages import CLIENT

_SCRIPT = """
import { readFileSync } from "node:fs";
globalThis.document = { baseURI: "http://localhost/" };
Promise.withResolvers ??= () => {
  const parts = {};
  parts.promise = new Promise((resolve, reject) => Object.assign(parts, { resolve, reject }));
  return parts;
};
const [client, path, leaves] = process.argv.slice(1);
const { openModel } = await import(`${client}/model.js`);
const { memoryDevice } = await import(`${client}/memory_device.js`);
const plans = JSON.parse(readFileSync(new URL(`${client}/plans.json`), "utf-8"));
const kernels = Promise.withResolvers();
const stop = new AbortController();
const told = [];
const options = { signal: stop.signal, onChange() {}, onError() {}, onBegin: () => told.push("begun") };
const opening = openModel(kernels.promise, new Uint8Array(readFileSync(path)).buffer, "knot.ply", options);
opening.then(() => told.push("opened"), ({ name }) => told.push(name));
const rest = () => new Promise((resolve) => setTimeout(resolve, 100));
await rest();
kernels.resolve({ device: memoryDevice({ maxTextureDimension2D: 4096 }), plans });
if (leaves) stop.abort();
await rest();
console.log(told.join());
"""


def test_who_leaves_as_the_device_comes_hears_of_no_rows(tmp_path: Path) -> None:
    package("types-0.1.74", needs_node=True)  # Node.js is there where other packages are
    path = tmp_path / "knot.ply"
    write_ply(path, torus_knot(300, degree=1))
    command = ["node", "--input-type=module", "--eval", _SCRIPT, CLIENT.as_uri(), str(path)]
    stays, leaves = (
        subprocess.run([*command, word], capture_output=True, text=True, check=True).stdout
        for word in ("", "leaves")
    )
    assert (stays, leaves) == ("begun,opened\n", "AbortError\n")
