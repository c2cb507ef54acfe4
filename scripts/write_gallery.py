"""Draw the pictures of docs/gallery.md by running the page's blocks: `make gallery`.

A comment before a block names its result:

    <!-- gallery: things.py -->                      a script, or with another name commands
    <!-- gallery: frame.jpg 3 = a.png b.png -->      a picture: these files, three in a row
    <!-- gallery: small.jpg 2 x4 = a.png b.png -->   the same, each pixel enlarged to 4 × 4
    <!-- gallery: garden.jpg = a.png; needs data.npz -->  skipped if that file is missing

Data are in `data/garden` of the folder that GSGEN_SHARED names, as for the demo.

All blocks run in one folder, in the order of the page, as a reader would run them. The comment of a
picture's JPEG is a digest of the blocks that it depends on: a test sees when they change.
"""

import hashlib
import io
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "gallery.md"
ASSETS = ROOT / "docs" / "assets" / "gallery"
DATA = (ROOT / os.environ.get("GSGEN_SHARED", "../shared")) / "data" / "garden"
LIMIT = 60_000  # bytes of a picture
GAP = 6  # pixels between the parts of one

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
        parts: Files that the picture is put together from; none where it is no picture.
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


def main(folder: Path = ROOT / "out" / "gallery", assets: Path = ASSETS) -> None:
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


if __name__ == "__main__":
    main()
