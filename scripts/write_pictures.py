"""Draw the pictures of the plugins' pages anew, into docs/assets/plugins: `make pictures`.

They are the strips of the demo, as JPEG of 40 kB at most. Without arguments all are made;
give names of plugins for theirs alone.
"""

import io
import sys
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "assets" / "plugins"
LIMIT = 40_000  # bytes

sys.path.insert(0, str(ROOT / "docs" / "examples"))
import demo_families  # noqa: E402


def compressed(picture: Image.Image) -> bytes:
    """Return a JPEG of the best quality that is not larger than the limit.

    Raises:
        ValueError: There is none.
    """
    for quality in range(90, 20, -5):
        buffer = io.BytesIO()
        picture.save(buffer, "JPEG", quality=quality, optimize=True, progressive=True)
        if buffer.tell() <= LIMIT:
            return buffer.getvalue()
    raise ValueError(f"no quality makes it {LIMIT} bytes")


def main(names: list[str]) -> int:
    """Draw and write; return the exit code."""
    known = demo_families.demo_plugins()
    if unknown := [name for name in names if name not in known]:
        sys.exit(f"{unknown[0]!r} has no demo; expected one of: {', '.join(known)}")
    PICTURES.mkdir(parents=True, exist_ok=True)
    families = names or list(known)
    for example in demo_families.make_all(ROOT / "out" / "demo" / "families", families):
        if example.strip is None:
            sys.exit(f"{example.name} cannot be drawn: {example.trouble}")
        with Image.open(example.strip) as strip:
            data = compressed(strip.convert("RGB"))
        path = PICTURES / f"{example.name}.jpg"
        path.write_bytes(data)
        sys.stdout.write(f"{path.relative_to(ROOT)}: {len(data):,} bytes\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
