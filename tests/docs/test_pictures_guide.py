"""The guide "From a repository and a picture to a page": every block, as a reader types it.

With GSGEN_LGM, the folder of a checkout of 3DTopia/LGM, its own code runs; else a stand-in.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gsgen.formats import open_splats
from support.commands import ROOT
from support.reports.pages import DOCS

PAGE = DOCS / "guides" / "pictures-to-gaussians.md"
BLOCKS = re.findall(
    r"^<!-- lgm: (\S+) -->\n```\w+\n(.*?)^```$", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE
)
STAND_IN = ROOT / "tests" / "support" / "lgm_checkout"
PICTURE = "data_test/catstatue_rgba.png"


def checkout(folder: Path) -> Path:
    """Copy LGM's repository, or write the stand-in with a picture of a ball."""
    named = os.environ.get("GSGEN_LGM")
    shutil.copytree(named or STAND_IN, folder)
    if not named:
        y, x = np.mgrid[-1:1:90j, -1:1:90j]
        pixels = np.zeros((90, 90, 4), np.uint8)
        is_inside = np.hypot(x, y) < 0.8
        pixels[is_inside] = (230, 140, 40, 255)
        (folder / PICTURE).parent.mkdir()
        Image.fromarray(pixels).save(folder / PICTURE)
    return folder


@pytest.mark.slow
def test_the_guide_ends_with_a_model_a_film_a_sog_and_a_page(tmp_path: Path) -> None:
    folder = checkout(tmp_path / "LGM")
    (module, script), *commands = BLOCKS
    assert module == "lgm_small.py"
    (folder / module).write_text(script, "utf-8")
    environment = os.environ | {
        "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    }
    output = ""
    for mark, text in commands:
        assert mark == "bash"
        completed = subprocess.run(
            ["bash", "-e", "-c", text],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=900,
        )
        output += completed.stdout + completed.stderr
        assert completed.returncode == 0, output
    assert "conforms at level behaviour" in output  # the export
    assert "\nconforms: " in output  # the validation
    assert "turn.mp4: 6 frames of 96×96" in output
    splats = open_splats(folder / "object.sog")
    assert 100 < len(splats) <= 4 * 32 * 32
    page = (folder / "object.html").read_text("utf-8")
    assert "<gsgen-model" in page
