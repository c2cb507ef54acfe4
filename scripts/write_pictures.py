"""Draw pictures of the documentation with gsgen's own renderer.

    write_pictures.py plugins [NAME…]   the plugins' pages: the strips of the demo (`make pictures`)
    write_pictures.py gallery           docs/gallery.md, by running its blocks (`make gallery`)
    write_pictures.py hero              the picture of README.md and the home page (`make hero`)
    write_pictures.py tutorial          what the cells of the tutorial show (`make tutorial`)

In the gallery, a comment before a block names its result:

    <!-- gallery: things.py -->                      a script, or with another name commands
    <!-- gallery: frame.jpg 3 = a.png b.png -->      a picture: these files, three in a row
    <!-- gallery: small.jpg 2 x4 = a.png b.png -->   the same, each pixel enlarged to 4 × 4
    <!-- gallery: garden.jpg = a.png; needs data.npz -->  skipped if that file is missing

Data are in `data/garden` of the folder that GSGEN_SHARED names, as for the demo.

All blocks run in one folder, in the order of the page, as a reader would run them. The comment of a
picture's JPEG is a digest of the blocks that it depends on: a test sees when they change.
"""

import ast
import contextlib
import hashlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "gallery.md"
ASSETS = ROOT / "docs" / "assets"
DATA = (ROOT / os.environ.get("GSGEN_SHARED", "../shared")) / "data" / "garden"
LIMIT = 60_000  # bytes of a picture
GAP = 6  # pixels between the parts of one
STRIP_LIMIT = 40_000  # bytes
HERO_LIMIT = 170_000  # bytes
WIDTH, HEIGHT = 1200, 500  # of the scene
TILE = 200  # pixels, width and height of a plugin's frame
HERO_PLUGINS = {  # name of the plugin → the frame of its strip
    "scaffold-gs": 1,
    "octree-gs": 2,
    "duplex-gs": 3,
    "hexplane-4dgs": 4,
    "gauhuman": 2,
    "deformable-3dgs": 2,
}


_BLOCK = re.compile(
    r"^<!-- gallery: (?P<name>[\w.-]+)(?: (?P<columns>\d+))?(?: x(?P<enlarged>\d+))?"
    r"(?: = (?P<parts>[^;>]+?))?(?:; needs (?P<needs>[\w.-]+))? -->\n"
    r"```(?P<language>\w+)\n(?P<text>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """A code block of the gallery page, with its result.

    Attributes:
        name: Of the picture or the script.
        language: ``bash`` or ``python``.
        text: The code.
        parts: Files that the picture is put together from; empty for a script.
        columns: How many of them stand in a row; 0 for all.
        enlarged: How many pixels one becomes, each way.
        needs: A file of data without which it cannot run; empty for none.
    """

    name: str
    language: str
    text: str
    parts: tuple[str, ...]
    columns: int
    enlarged: int
    needs: str


def blocks(text: str) -> list[Block]:
    """Return the blocks of a page, in order."""
    return [
        Block(
            name=match["name"],
            language=match["language"],
            text=match["text"],
            parts=tuple((match["parts"] or "").split()),
            columns=int(match["columns"] or 0),
            enlarged=int(match["enlarged"] or 1),
            needs=match["needs"] or "",
        )
        for match in _BLOCK.finditer(text)
    ]


def digests(page: list[Block]) -> dict[str, str]:
    """Return the digest of each picture's block and of all earlier blocks without pictures."""
    page_digests, before = {}, hashlib.sha256()
    for block in page:
        digest = hashlib.sha256(before.digest() + repr(block).encode())
        if block.parts:
            page_digests[block.name] = digest.hexdigest()[:16]
        else:
            before = digest
    return page_digests


def run(block: Block, folder: Path) -> None:
    """Run a block as a reader would.

    Raises:
        SystemExit: It fails; with what it printed.
    """
    command = ["bash", "-euc", block.text]
    if block.language == "python":
        script = folder / f"{Path(block.name).stem}.py"
        script.write_text(block.text, "utf-8")
        command = [sys.executable, script.name]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    completed = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | {"PATH": path, "PYTHONIOENCODING": "utf-8"},
        capture_output=True,
        encoding="utf-8",
    )
    if completed.returncode:
        sys.exit(
            f"{block.name} ended with {completed.returncode}\n{completed.stdout}{completed.stderr}"
        )


def assembled(block: Block, folder: Path) -> Image.Image:
    """Compose the parts of a picture, row by row on white."""
    parts = []
    for part in block.parts:
        with Image.open(folder / part) as picture:
            drawn = picture.convert("RGB")
        size = (drawn.width * block.enlarged, drawn.height * block.enlarged)
        parts.append(drawn.resize(size, Image.Resampling.NEAREST))
    columns = block.columns or len(parts)
    rows = -(-len(parts) // columns)
    width, height = parts[0].width + GAP, parts[0].height + GAP
    sheet = Image.new("RGB", (columns * width - GAP, rows * height - GAP), "white")
    for index, part in enumerate(parts):
        sheet.paste(part, (index % columns * width, index // columns * height))
    return sheet


def compressed(picture: Image.Image, limit: int, comment: str = "") -> bytes:
    """Return a JPEG of the best quality that is not larger than ``limit`` bytes.

    Raises:
        ValueError: Even the lowest quality is larger.
    """
    for quality in range(90, 20, -4):
        buffer = io.BytesIO()
        picture.save(
            buffer, "JPEG", quality=quality, optimize=True, progressive=True, comment=comment
        )
        if buffer.tell() <= limit:
            return buffer.getvalue()
    raise ValueError(f"is larger than {limit} bytes at every quality")


def write_gallery(
    folder: Path = ROOT / "out" / "gallery", assets: Path = ASSETS / "gallery"
) -> None:
    """Run all blocks in ``folder``, and write the pictures into ``assets``."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    assets.mkdir(parents=True, exist_ok=True)
    page = blocks(PAGE.read_text("utf-8"))
    digest = digests(page)
    for block in page:
        if block.needs and not (DATA / block.needs).is_file():
            sys.stdout.write(f"{block.name}: left out, {DATA / block.needs} is missing\n")
            continue
        if block.needs:
            shutil.copy(DATA / block.needs, folder)
        run(block, folder)
        if block.parts:
            data = compressed(assembled(block, folder), LIMIT, digest[block.name])
            (assets / block.name).write_bytes(data)
            sys.stdout.write(f"{block.name}: {len(data):,} bytes\n")


def write_strips(names: list[str]) -> None:
    """Write the demo's strips of some plugins, or of all; each is a JPEG of at most 40 kB."""
    sys.path.insert(0, str(ROOT / "docs" / "examples"))
    import demo_families

    pictures = ASSETS / "plugins"
    known = demo_families.demo_plugins()
    if unknown := [name for name in names if name not in known]:
        sys.exit(f"{unknown[0]!r} has no demo; expected one of: {', '.join(known)}")
    pictures.mkdir(parents=True, exist_ok=True)
    families = names or list(known)
    for example in demo_families.make_all(ROOT / "out" / "demo" / "families", families):
        if example.strip is None:
            sys.exit(f"{example.name} cannot be drawn: {example.trouble}")
        with Image.open(example.strip) as strip:
            data = compressed(strip.convert("RGB"), STRIP_LIMIT)
        path = pictures / f"{example.name}.jpg"
        path.write_bytes(data)
        sys.stdout.write(f"{path.relative_to(ROOT)}: {len(data):,} bytes\n")


def hero_scene(folder: Path) -> Image.Image:
    """Draw the sample scene with two sunflowers in it."""
    from gsgen.reference_plugins.samples import write_samples

    write_samples(folder)
    document = json.loads((folder / "scene.json").read_text("utf-8"))
    offsets = ([1.35, 0, 1.0], [-1.6, 0, 0.45])
    document["models"] = [
        "garden.ply",
        *({"path": "sunflower.onnx", "translate": offset, "scale": 0.9} for offset in offsets),
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
    with Image.open(ASSETS / "plugins" / f"{name}.jpg") as strip:
        side = strip.height
        frame = strip.convert("RGB").crop((number * side, 0, (number + 1) * side, side))
    frame = frame.resize((TILE, TILE), Image.Resampling.LANCZOS)
    draw = ImageDraw.Draw(frame)
    draw.rectangle((0, TILE - 26, TILE, TILE), fill="#16181d")
    font = ImageFont.load_default(15)
    draw.text((TILE / 2, TILE - 13), name, fill="#e6e8ee", font=font, anchor="mm")
    return frame


def write_hero(path: Path = ASSETS / "hero.jpg") -> None:
    """Draw the picture and write it."""
    with tempfile.TemporaryDirectory() as folder:
        drawn = hero_scene(Path(folder))
    sheet = Image.new("RGB", (WIDTH, HEIGHT + TILE))
    sheet.paste(drawn, (0, 0))
    for column, (name, number) in enumerate(HERO_PLUGINS.items()):
        sheet.paste(plugin_frame(name, number), (column * TILE, HEIGHT))
    path.write_bytes(compressed(sheet, HERO_LIMIT))
    sys.stdout.write(f"{path.relative_to(ROOT)}: {path.stat().st_size:,} bytes\n")


def write_tutorial() -> None:
    """Run the cells of the notebook in an empty folder, and store what each shows."""
    from docs_parts.pages.tutorial import OUTPUTS, cells, text_of

    shutil.rmtree(OUTPUTS.parent, ignore_errors=True)
    OUTPUTS.parent.mkdir(parents=True)
    namespace: dict[str, Any] = {"__name__": "tutorial"}
    outputs: dict[str, dict[str, str]] = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for cell in cells():
            if cell["cell_type"] != "code":
                continue
            tree = ast.parse(cell["source"])
            last = ast.unparse(tree.body.pop()) if isinstance(tree.body[-1], ast.Expr) else "None"
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                exec(compile(tree, "<cell>", "exec"), namespace)
                value = eval(last, namespace)
            output = outputs[cell["id"]] = {"digest": cell["digest"]}
            png = getattr(value, "_repr_png_", lambda: None)()
            if png is not None:
                output["picture"] = f"{cell['id']}.jpg"
                with Image.open(io.BytesIO(png)) as picture:
                    data = compressed(picture.convert("RGB"), LIMIT)
                (OUTPUTS.parent / output["picture"]).write_bytes(data)
            elif text := text_of(value, printed.getvalue()):
                output["text"] = text
    OUTPUTS.write_text(json.dumps(outputs, indent=2, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["plugins", *names]:
            write_strips(names)
        case ["gallery"]:
            write_gallery()
        case ["hero"]:
            write_hero()
        case ["tutorial"]:
            write_tutorial()
        case _:
            sys.exit(f"usage: {sys.argv[0]} plugins [NAME…], gallery, hero or tutorial")
