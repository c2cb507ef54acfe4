"""Draw the picture that README.md and the documentation open with: `make hero`.

Above, the sample scene; below, one frame of some plugins'
pictures (`make pictures`). All of it is drawn by gsgen's own renderer.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from gsgen.reference_plugins.samples import write_samples

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))
from write_gallery import compressed  # noqa: E402

HERO = ROOT / "docs" / "assets" / "hero.jpg"
LIMIT = 170_000  # bytes
WIDTH, HEIGHT = 1200, 500  # of the scene
TILE = 200  # pixels, width and height of a plugin's frame
PLUGINS = {  # name of the plugin → the frame of its strip
    "scaffold-gs": 1,
    "octree-gs": 2,
    "duplex-gs": 3,
    "hexplane-4dgs": 4,
    "gauhuman": 2,
    "deformable-3dgs": 2,
}


def scene(folder: Path) -> Image.Image:
    """Draw the sample scene with two sunflowers in it."""
    write_samples(folder)
    document = json.loads((folder / "scene.json").read_text("utf-8"))
    places = ([1.35, 0, 1.0], [-1.6, 0, 0.45])
    document["models"] = [
        "garden.ply",
        *({"path": "sunflower.onnx", "translate": place, "scale": 0.9} for place in places),
    ]
    document |= {"width": WIDTH, "height": HEIGHT, "camera": "look-at:-0.8,-1.65,3.6,0.1,-0.85,0"}
    (folder / "hero.json").write_text(json.dumps(document), "utf-8")
    words = ["render", "hero.json", "-o", "hero.png", "--time", "0.2", "--fov", "40"]
    environment = os.environ | {"PYTHONUTF8": "1"}
    command = [sys.executable, "-m", "gsgen.cli", *words]
    subprocess.run(command, cwd=folder, check=True, env=environment)
    with Image.open(folder / "hero.png") as picture:
        return picture.convert("RGB")


def plugin_frame(name: str, number: int) -> Image.Image:
    """Return one frame of a plugin's strip, with the plugin's name."""
    with Image.open(ROOT / "docs" / "assets" / "plugins" / f"{name}.jpg") as strip:
        side = strip.height
        frame = strip.convert("RGB").crop((number * side, 0, (number + 1) * side, side))
    frame = frame.resize((TILE, TILE), Image.Resampling.LANCZOS)
    draw = ImageDraw.Draw(frame)
    draw.rectangle((0, TILE - 26, TILE, TILE), fill="#16181d")
    font = ImageFont.load_default(15)
    draw.text((TILE / 2, TILE - 13), name, fill="#e6e8ee", font=font, anchor="mm")
    return frame


def main(path: Path = HERO) -> None:
    """Draw the picture and write it."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = scene(Path(folder))
    sheet = Image.new("RGB", (WIDTH, HEIGHT + TILE))
    sheet.paste(drawn, (0, 0))
    for column, (name, number) in enumerate(PLUGINS.items()):
        sheet.paste(plugin_frame(name, number), (column * TILE, HEIGHT))
    path.write_bytes(compressed(sheet, LIMIT))
    sys.stdout.write(f"{path.relative_to(ROOT)}: {path.stat().st_size:,} bytes\n")


if __name__ == "__main__":
    main()
