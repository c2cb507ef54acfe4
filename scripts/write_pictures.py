"""Draw the pictures of the plugins' pages into docs/assets/plugins: `make pictures`.

The pictures are the strips of the demo, as JPEG of at most 40 kB. Arguments are names of plugins;
without arguments all pictures are drawn.
"""

import sys
from pathlib import Path

from PIL import Image
from write_gallery import compressed

ROOT = Path(__file__).parents[1]
PICTURES = ROOT / "docs" / "assets" / "plugins"
LIMIT = 40_000  # bytes

sys.path.insert(0, str(ROOT / "docs" / "examples"))
import demo_families  # noqa: E402


def main(names: list[str]) -> int:
    """Draw and write the pictures of some plugins, and return the exit code."""
    known = demo_families.demo_plugins()
    if unknown := [name for name in names if name not in known]:
        sys.exit(f"{unknown[0]!r} has no demo; expected one of: {', '.join(known)}")
    PICTURES.mkdir(parents=True, exist_ok=True)
    families = names or list(known)
    for example in demo_families.make_all(ROOT / "out" / "demo" / "families", families):
        if example.strip is None:
            sys.exit(f"{example.name} cannot be drawn: {example.trouble}")
        with Image.open(example.strip) as strip:
            data = compressed(strip.convert("RGB"), LIMIT)
        path = PICTURES / f"{example.name}.jpg"
        path.write_bytes(data)
        sys.stdout.write(f"{path.relative_to(ROOT)}: {len(data):,} bytes\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
