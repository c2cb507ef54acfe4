"""The gallery: every picture comes from the blocks that stand there today, and is small."""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from support.commands import ROOT
from support.reports.pages import DOCS

PAGE = DOCS / "gallery.md"
PICTURES = DOCS / "assets" / "gallery"
MOST_BYTES = 800_000  # of all pictures that only this page shows


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location(
        "write_pictures", ROOT / "scripts" / "write_pictures.py"
    )
    assert spec is not None
    assert spec.loader is not None
    result = importlib.util.module_from_spec(spec)
    sys.modules["write_pictures"] = result  # dataclasses look their module up
    spec.loader.exec_module(result)
    return result


def test_every_picture_is_of_the_blocks_that_stand_there(script: ModuleType) -> None:
    digests = script.digests(script.blocks(PAGE.read_text("utf-8")))
    assert len(digests) >= 10
    for name, digest in digests.items():
        with Image.open(PICTURES / name) as picture:
            gaussians = picture.info["comment"].decode()
        assert gaussians == digest, f"{name} is older than its block: run make gallery"


def test_every_picture_is_shown_and_small(script: ModuleType) -> None:
    text = PAGE.read_text("utf-8")
    result = script.digests(script.blocks(text))
    retained = {path.name: path.stat().st_size for path in PICTURES.iterdir()}
    assert set(retained) == set(result)
    assert max(retained.values()) <= script.LIMIT
    assert sum(retained.values()) <= MOST_BYTES
    shown = re.findall(r"^!\[(.{20,})\]\(assets/gallery/(\S+)\)$", text, re.MULTILINE)
    assert [name for _, name in shown] == list(result)


def test_every_family_is_shown() -> None:
    shown = re.findall(r"\(assets/plugins/(\S+)\)", PAGE.read_text("utf-8"))
    assert sorted(shown) == sorted(path.name for path in (DOCS / "assets/plugins").iterdir())


def test_every_block_with_a_mark_is_understood(script: ModuleType) -> None:
    text = PAGE.read_text("utf-8")
    assert len(script.blocks(text)) == text.count("<!-- gallery: ")


def test_changed_block_makes_dependent_pictures_stale(script: ModuleType) -> None:
    page = PAGE.read_text("utf-8")
    before = script.digests(script.blocks(page))
    own = script.digests(script.blocks(page.replace("--fov 42", "--fov 43")))
    assert [name for name in before if own[name] != before[name]] == ["harmonics.jpg"]
    changed_digests = script.digests(script.blocks(page.replace("20_000", "20_001")))
    unchanged = [name for name in before if changed_digests[name] == before[name]]
    assert unchanged == ["samples.jpg", "sunflower.jpg"]  # those that stand before the knot


def test_picture_is_composed_as_its_marker_states(script: ModuleType, tmp_path: Path) -> None:
    text = (
        "<!-- gallery: two.jpg 2 x3 = a.png b.png c.png -->\n```python\n"
        "from PIL import Image\n"
        "for name, grey in (('a', 0), ('b', 120), ('c', 200)):\n"
        "    Image.new('RGB', (4, 2), (grey,) * 3).save(f'{name}.png')\n```\n"
    )
    (block,) = script.blocks(text)
    script.run(block, tmp_path)
    result = np.asarray(script.assembled(block, tmp_path))[..., 0]
    assert result.shape == (2 * 6 + script.GAP, 2 * 12 + script.GAP)
    assert (result[:6, :12] == 0).all()
    assert (result[:6, -12:] == 120).all()
    assert (result[-6:, :12] == 200).all()
    assert (result[-6:, -12:] == 255).all()  # nothing is there


def test_a_block_that_fails_ends_the_script(script: ModuleType, tmp_path: Path) -> None:
    text = "<!-- gallery: bad.jpg = a.png -->\n```bash\necho why >&2; false\necho on\n```\n"
    (block,) = script.blocks(text)
    with pytest.raises(SystemExit, match=r"bad\.jpg ended with 1\nwhy"):
        script.run(block, tmp_path)
