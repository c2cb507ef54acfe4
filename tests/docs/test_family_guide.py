"""The guide "Add your own family": what it builds is small, can be installed, and conforms."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.contract.errors import GsgenError
from support.reports.pages import DOCS

TEXT = (DOCS / "guides" / "add-your-own-family.md").read_text("utf-8")
BLOCKS = re.findall(r"^<!-- family: (\S+) -->\n```\w+\n(.*?)^```$", TEXT, re.DOTALL | re.MULTILINE)
FILES = {name: text for name, text in BLOCKS if name != "bash"}
INSTALL, EXPORT, TEST = (text for name, text in BLOCKS if name == "bash")

Run = Callable[[str], "subprocess.CompletedProcess[str]"]


def test_the_family_has_fewer_than_a_hundred_lines() -> None:
    package = [name for name in FILES if name.startswith("gsgen_blend_shapes/")]
    assert len(package) == 3
    lines = [
        line
        for name in (*package, "pyproject.toml")
        for line in FILES[name].splitlines()
        if line.strip()
    ]
    assert len(lines) < 100


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Runs what the guide types, where its files lie and its package is installed aside."""
    folder, site = tmp_path_factory.mktemp("guide"), tmp_path_factory.mktemp("site")
    for name, text in FILES.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, "utf-8")
    assert INSTALL == "pip install .\n"
    # What it depends on is here, and the environment of the tests is left as it is.
    install_options = ["--no-deps", "--no-build-isolation", "--quiet", "--target", str(site)]
    installed = subprocess.run(
        [sys.executable, "-m", "pip", "install", *install_options, str(folder)],
        capture_output=True,
        text=True,
    )
    assert installed.returncode == 0, installed.stderr
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(site)}

    def typed(command: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            ["bash", "-e", "-c", command],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            timeout=300,
        )

    result = typed("python make_checkpoint.py")
    assert result.returncode == 0, result.stderr
    return typed


@pytest.mark.slow
def test_family_of_the_guide_is_exported_and_conforms(run: Run) -> None:
    exported = run(EXPORT)
    assert exported.returncode == 0, exported.stderr
    assert "face.onnx: 3,000 rows" in exported.stdout
    assert "agrees with torch" in exported.stdout
    tested = run(TEST)
    assert tested.returncode == 0, tested.stdout + tested.stderr
    assert "failed" not in tested.stdout
    assert int(re.search(r"(\d+) passed", tested.stdout)[1]) > 50  # type: ignore[index]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"color": np.zeros((4, 2))}, r"color is \[4, 2\], expected \['N', 3\]"),
        ({"logit_opacity": np.full(4, np.nan)}, "of finite numbers"),
        ({"color_shapes": np.zeros((3, 4, 3))}, r"color_shapes is \[3, 4, 3\]"),
        ({"quaternion": None}, "no quaternion"),
        ({"extra": np.zeros(1)}, "unexpected extra"),
    ],
)
def test_a_wrong_file_is_named(
    change: dict[str, np.ndarray | None], words: str, tmp_path: Path
) -> None:
    names: dict[str, Any] = {}
    exec(FILES["gsgen_blend_shapes/checkpoint.py"], names)
    sizes = {"N": 4, "K": 2}
    right = {
        name: np.ones([sizes.get(entry, entry) for entry in expected])
        for name, expected in names["SHAPES"].items()
    }
    np.savez(tmp_path / "right.npz", **right)
    assert set(names["read_shapes"](tmp_path / "right.npz")) == set(right)
    wrong = {name: entry for name, entry in (right | change).items() if entry is not None}
    np.savez(tmp_path / "wrong.npz", **wrong)
    with pytest.raises(GsgenError, match=words):
        names["read_shapes"](tmp_path / "wrong.npz")
    (tmp_path / "wrong.npz").write_text("no archive")
    with pytest.raises(GsgenError, match="cannot be read"):
        names["read_shapes"](tmp_path / "wrong.npz")
