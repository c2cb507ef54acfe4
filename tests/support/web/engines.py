"""Engines of other makers, and the example pages that show models in them."""

import subprocess
from pathlib import Path

from support.commands import ROOT
from support.web.packages import package, require_node

ENGINES = ("playcanvas", "babylon", "spark")
_EXAMPLES = ROOT / "docs/examples/engines"


def engine_pages(folder: Path) -> dict[str, bytes]:
    """Return what a server needs for the example pages, by path: the pages and the engines.

    Args:
        folder: Where PlayCanvas is packed into one file.
    """
    source = package("playcanvas-2.23.3", needs_node=True) / "src/index.js"
    esbuild = package("frameworks") / "node_modules/esbuild/bin/esbuild"
    built = folder / "playcanvas.mjs"
    command = [require_node(), str(esbuild), str(source), "--bundle", "--format=esm"]
    subprocess.run([*command, f"--outfile={built}"], check=True, capture_output=True)
    files = {
        "/none.html": None,
        "/playcanvas/build/playcanvas.mjs": built,
        "/babylon/babylon.js": package("babylonjs-9.35.0") / "babylon.js",
        "/spark/dist/spark.module.js": package("spark-2.2.0") / "spark.module.js",
    } | {f"/{name}.html": _EXAMPLES / f"{name}.html" for name in ENGINES}
    return {name: path.read_bytes() if path else b"" for name, path in files.items()}
