"""Every marked code block is run as a reader would run it, page by page."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.spec.spherical_harmonics import basis
from gsgen.contract.validation.rule import Scope
from gsgen.contract.validation.settings import read_config
from support.commands import ROOT
from support.reports.pages import DOCS, README, Block, blocks, name_of, pages

_BINARIES = Path(sys.executable).parent


def run(block: Block, folder: Path) -> "subprocess.CompletedProcess[str]":
    if block.mark.endswith(".json"):  # a file that later blocks read
        (folder / block.mark).write_text(block.text, "utf-8")
        return subprocess.CompletedProcess([], 0, "", "")
    if block.mark == "bash":
        command = ["bash", "-e", "-c", block.text]
    else:
        (folder / block.mark).write_text(block.text, "utf-8")
        command = [sys.executable, block.mark]
    path = os.pathsep.join([str(_BINARIES), os.environ["PATH"]])
    return subprocess.run(
        command,
        cwd=folder,
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
        timeout=300,
    )


# The commands of that guide, which test_examples.py runs.
EXPORTED = ("gsgen export lit_mlp:", "gsgen export deforming_cloud:", "gsgen export avatar:")


def is_run(block: Block) -> bool:
    return block.mark == "bash" or block.mark.endswith((".py", ".json"))


_RUN = [page for page in pages() if any(is_run(block) for block in blocks(page))]


def _tier(page: Path) -> object:
    """Return README or a guide as a test of the fast tier, unless it builds a city."""
    is_fast = page == README or (page.parent.name == "guides" and page.stem != "stream-a-city")
    return pytest.param(page, id=name_of(page), marks=[] if is_fast else pytest.mark.slow)


@pytest.mark.parametrize("page", [_tier(page) for page in _RUN])
def test_every_block_runs(page, tmp_path):
    for block in blocks(page):
        if is_run(block):
            completed = run(block, tmp_path)
            assert completed.returncode == 0, f"{block.mark}:\n{completed.stdout}{completed.stderr}"


# What a block may begin with that no test runs: it needs a network, a screen, or sets up all.
_UNTESTED_COMMANDS = (
    "make demo",
    "pip install",
    "python3 -m venv",
    "git clone",
    "podman build",
    "from gsgen.runtime import view",
)
_FENCE = re.compile(
    r"(?:^<!-- (?P<mark>.+?) -->\n)?^```(?:bash|python)\n(?P<text>.*?)^```$", re.S | re.M
)


@pytest.mark.parametrize(
    "page",
    [
        page
        for page in pages()
        if page.parent.name in ("guides", "docs", ROOT.name) and page != DOCS / "tutorial.md"
    ],  # the tutorial's are the cells of its notebook, which test_tutorial.py runs
    ids=name_of,
)
def test_every_block_of_a_guide_is_run(page: Path) -> None:
    """By this file, or by a test of the page: examples, the gallery, generated output."""
    unmarked = [
        match["text"].partition("\n")[0]
        for match in _FENCE.finditer(page.read_text("utf-8"))
        if match["mark"] is None and not match["text"].startswith(_UNTESTED_COMMANDS)
    ]
    commands = EXPORTED if page.stem == "export-your-method" else ()
    assert [line for line in unmarked if not line.startswith(commands or "\0")] == []


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_every_marked_manifest_can_be_read(page):
    for block in blocks(page):
        if block.mark == "manifest":
            assert block.language == "json"
            loads(block.text)


@pytest.mark.parametrize("page", pages(), ids=name_of)
def test_every_marked_configuration_can_be_read(page, tmp_path):
    for block in blocks(page):
        if block.mark == "config":
            path = tmp_path / "gsgen.toml"
            path.write_text(block.text, "utf-8")
            read_config(path, installed_rules())


def test_the_guide_lists_every_scope_of_a_rule():
    text = (DOCS / "guides" / "writing-a-rule.md").read_text("utf-8")
    listed = re.findall(r'^\| .+ \| `(?:over=)?"(\w+)"` \|', text, re.MULTILINE)
    assert set(listed) == set(get_args(Scope))


def test_every_mark_is_one_that_a_test_knows():
    marked = re.compile(r"<!-- test: (.+?) -->")
    for page in pages():
        known = {block.mark for block in blocks(page)} | {"sh basis"}
        assert set(marked.findall(page.read_text("utf-8"))) <= known, page


def test_the_workflow_runs_what_the_guide_tries():
    """The guide's workflow is not run by a test, but its commands are those that are."""
    page = DOCS / "guides" / "validate-in-ci.md"
    tested_text = "".join(block.text for block in blocks(page) if block.mark == "bash")
    text = page.read_text("utf-8")
    (command,) = re.findall(r"- run: (gsgen validate .+)", text)
    assert command in tested_text
    summary = re.search(r"run: (python summary.py report.json) >>", text)
    assert summary is not None
    assert summary[1] in tested_text


def test_the_basis_in_the_specification_is_that_of_the_code():
    text = (DOCS / "spec" / "layout.md").read_text("utf-8")
    table = text.partition("<!-- test: sh basis -->")[2].partition("\n\n")[0]
    formulas = re.findall(r"^\| (\d+) \| (\d) \| `(.+)` \|$", table, re.MULTILINE)
    assert [int(k) for k, _, _ in formulas] == list(range(16))
    assert [int(d) for _, d, _ in formulas] == [0, *[1] * 3, *[2] * 5, *[3] * 7]
    directions = np.random.default_rng(3).normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = directions.T
    names = {"x": x, "y": y, "z": z}
    result = [eval(formula, names) + 0 * x for _, _, formula in formulas]
    np.testing.assert_allclose(np.stack(result, axis=1), basis(directions), rtol=1e-14)


def test_the_rule_of_the_guide_can_be_installed(tmp_path):
    """Its entry point, as the guide's pyproject.toml has it, brings the rule to the commands."""
    page = DOCS / "guides" / "writing-a-rule.md"
    module = next(block.text for block in blocks(page) if block.mark == "acme_rules.py")
    (tmp_path / "acme_rules.py").write_text(module, "utf-8")
    text = page.read_text("utf-8")
    section = re.search(r'\[project\.entry-points\."(gsgen\.rules)"\]\n(.+ = ".+")\n', text)
    assert section is not None
    info = tmp_path / "acme_gsgen_rules-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: acme-gsgen-rules\nVersion: 0.1.0\n"
    )
    points = f"[{section[1]}]\n{section[2].replace(chr(34), '')}\n"
    (info / "entry_points.txt").write_text(points)
    completed = subprocess.run(
        [sys.executable, "-m", "gsgen.cli", "explain", "acme/AC001"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert completed.stdout.startswith("# acme/AC001 licence-named\n"), completed.stderr
