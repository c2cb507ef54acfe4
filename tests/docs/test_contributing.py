"""CONTRIBUTING.md names places that exist, and an extension that touches them alone works."""

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import dedent

import numpy as np
import onnx
import pytest

from gsgen.conformance.fixtures.builders.clouds import COLORS, still
from support.commands import ROOT
from support.reports.pages import links

PAGE = ROOT / "CONTRIBUTING.md"
TEXT = PAGE.read_text("utf-8")

_ROW = re.compile(r"^\| (?P<name>[\w ]+) \| (?P<places>.*`.*) \|$", re.MULTILINE)
_EXAMPLE = re.compile(
    r"^<!-- append: (?P<path>\S+) -->\n```python\n(?P<code>.*?)^```$", re.MULTILINE | re.DOTALL
)
_PATHS_BY_EXTENSION = {
    row["name"]: [path for path in re.findall(r"`([^`]+)`", row["places"]) if "/" in path]
    for row in _ROW.finditer(TEXT.partition("| extension | places |")[2])
}
_ROOTS = ("contract", "sdk", "runtime", "reference_plugins")


@dataclass
class Copy:
    """A copy of some packages, which shadows the installed ones, and the files it has changed.

    Attributes:
        folder: The folder that Python searches first.
        touched: Changed or new files, from the root of the repository.
    """

    folder: Path
    touched: list[str] = field(default_factory=list)

    def take(self, *packages: str) -> None:
        for package in packages:
            inner = package.partition("/")[2]
            shutil.copytree(
                ROOT / package, self.folder / inner, ignore=shutil.ignore_patterns("__pycache__")
            )

    def write(self, path: str, text: str) -> None:
        file = self._file(path)
        assert not file.exists(), f"{path} exists already"
        file.write_text(text, "utf-8")

    def append(self, path: str, text: str) -> None:
        file = self._file(path)
        file.write_text(file.read_text("utf-8") + "\n\n" + text, "utf-8")

    def insert(self, path: str, *, after: str, text: str) -> None:
        file = self._file(path)
        code = file.read_text("utf-8")
        assert code.count(after) == 1, f"{path}: {after}"
        file.write_text(code.replace(after, after + text), "utf-8")

    def _file(self, path: str) -> Path:
        root, _, inner = path.partition("/")
        assert root in _ROOTS
        if path not in self.touched:
            self.touched.append(path)
        return self.folder / inner

    def run(self, *arguments: str | Path) -> "subprocess.CompletedProcess[str]":
        """Run Python with the copy in front of the installed packages."""
        return subprocess.run(
            [sys.executable, *map(str, arguments)],
            cwd=self.folder,
            env=os.environ | {"PYTHONPATH": str(self.folder), "COLUMNS": "200"},
            capture_output=True,
            text=True,
            timeout=300,
        )

    def gsgen(self, *arguments: str | Path) -> "subprocess.CompletedProcess[str]":
        return self.run("-m", "gsgen.cli", *arguments)

    def assert_touches_only(self, extension: str) -> None:
        """Assert that each touched file is in a place of the extension, and each place is used."""
        places = _PATHS_BY_EXTENSION[extension]
        used = [
            max((location for location in places if f"{path}/".startswith(f"{location}/")), key=len)
            for path in self.touched
        ]
        assert sorted(used) == sorted(places)


@pytest.fixture
def copy(tmp_path: Path) -> Copy:
    return Copy(tmp_path)


def test_the_page_lists_every_extension() -> None:
    assert list(_PATHS_BY_EXTENSION) == [
        "rule",
        "pass",
        "splat format",
        "family",
        "command",
        "target",
    ]
    assert len(_PATHS_BY_EXTENSION["rule"]) == 2
    assert len(_PATHS_BY_EXTENSION["splat format"]) <= 3
    assert len(TEXT.splitlines()) < 150


def test_every_path_on_the_page_exists() -> None:
    paths = {path for path in re.findall(r"`([\w./-]+/[\w./-]*)`", TEXT) if "…" not in path}
    paths |= {link.partition("#")[0] for link in links(PAGE) if "://" not in link}
    assert {path for places in _PATHS_BY_EXTENSION.values() for path in places} <= paths
    missing = [path for path in paths if not (ROOT / path).exists() and path[0] != "."]
    assert missing == []


def test_every_make_target_and_entry_point_group_exists() -> None:
    makefile = (ROOT / "Makefile").read_text("utf-8")
    for target in re.findall(r"`make ([\w-]+)`", TEXT):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target
    project = (ROOT / "pyproject.toml").read_text("utf-8")
    groups = re.findall(r"entry point `([\w.]+)`", TEXT)
    assert groups == ["gsgen.generators"]
    for group in groups:
        assert f'[project.entry-points."{group}"]' in project


def test_the_rule_of_the_page_fails_its_fixture_alone(copy: Copy) -> None:
    copy.take("contract/gsgen")
    for example in _EXAMPLE.finditer(TEXT):
        copy.append(example["path"], example["code"])
    copy.assert_touches_only("rule")
    script = """
        import json
        from pathlib import Path
        from gsgen.conformance.fixtures import find
        from gsgen.contract import validate
        for name in ("dropout_left", "still_sh0"):
            report = validate(find(name).write(Path(".")))
            print(json.dumps(sorted({finding.rule for finding in report.findings})))
    """
    completed = copy.run("-c", dedent(script))
    assert completed.returncode == 0, completed.stderr
    assert [json.loads(line) for line in completed.stdout.splitlines()] == [["GG099"], []]
    explanation = copy.gsgen("explain", "GG099")
    assert explanation.returncode == 0, explanation.stderr
    assert "The graph has no Dropout node." in explanation.stdout


_PASS = '''\
"""Merges consecutive negations."""

from typing import ClassVar

import onnx_ir as ir

from gsgen.sdk.passes.framework.base import NodeRewrite, is_op
from gsgen.sdk.passes.framework.graph_builder import InsertionPoint


class MergeNegations(NodeRewrite):
    """Replace the negation of a negation by the number itself.

    Exporters write ``x - (-y)`` as two negations::

        Neg(Neg(x))   →   x
    """

    name: ClassVar[str] = "merge-negations"

    def matches(self, node: ir.Node) -> bool:
        """Return whether ``node`` negates the output of a Neg."""
        value = node.inputs[0] if is_op(node, "Neg") else None
        inner = value.producer() if value is not None else None
        return inner is not None and is_op(inner, "Neg")

    def replace(self, node: ir.Node) -> None:
        """Use the input of the first Neg."""
        InsertionPoint(node).replace(node.inputs[0].producer().inputs[0])
'''


def test_a_pass_touches_the_places_of_the_page(copy: Copy) -> None:
    copy.take("sdk/gsgen/sdk")
    registry = "sdk/gsgen/sdk/passes/registry.py"
    copy.write("sdk/gsgen/sdk/passes/simplify/merge_negations.py", _PASS)
    copy.insert(
        registry,
        after="import MergeCasts\n",
        text="from gsgen.sdk.passes.simplify.merge_negations import MergeNegations\n",
    )
    copy.insert(registry, after="    MergeCasts,\n", text="    MergeNegations,\n")
    copy.assert_touches_only("pass")
    model = still().replace_text(COLORS, "negated = Neg (colors) color = Neg (negated)").build()
    onnx.save(model, copy.folder / "model.onnx")
    completed = copy.gsgen("rewrite", "model.onnx", "-o", "out.onnx", "--pass", "merge-negations")
    assert completed.returncode == 0, completed.stdout + completed.stderr
    assert [node.op_type for node in model.graph.node].count("Neg") == 2
    rewritten = onnx.load(copy.folder / "out.onnx").graph.node
    assert [node.op_type for node in rewritten].count("Neg") == 0


_READER = '''\
"""Read DOTS files: a mark of four bytes, then x, y and z of each point as float32."""

__all__ = ["read_dots"]

import numpy as np

from gsgen.formats.shared.bytes import contents
from gsgen.formats.shared.files import FilePath
from gsgen.formats.shared.splats import PointCloud

MAGIC = b"DOTS"


def read_dots(path: FilePath, *, drop_invalid: bool = False) -> PointCloud:
    """Read the white points of the DOTS file at ``path``; all of them can be drawn."""
    with contents(path) as data:
        points = np.frombuffer(data[len(MAGIC) :], "<f4").reshape(-1, 3).copy()
    return PointCloud(points, np.ones_like(points))
'''


def test_a_splat_format_touches_the_places_of_the_page(copy: Copy) -> None:
    copy.take("sdk/gsgen/formats")
    codecs = "sdk/gsgen/formats/codecs.py"
    copy.write("sdk/gsgen/formats/dots.py", _READER)
    copy.insert(
        codecs,
        after="from gsgen.formats.npz import read_npz\n",
        text="from gsgen.formats.dots import MAGIC as DOTS_MAGIC, read_dots\n",
    )
    codec = (
        'Codec(name="dots", title="DOTS", contents="white points", suffixes=(".dots",), '
        "read=read_dots, magic_prefixes=(DOTS_MAGIC,)),"
    )
    copy.insert(codecs, after="CODECS: Final = (\n", text=f"    {codec}\n")
    copy.insert(
        "sdk/gsgen/formats/__init__.py",
        after="_MODULE_BY_NAME: Final = {\n",
        text='    "read_dots": "gsgen.formats.dots",\n',
    )
    copy.assert_touches_only("splat format")
    points = np.float32([[0, 0, 1], [1, 0, 2], [0, 1, 3], [1, 1, 4]])
    for name in ("points.dots", "without_suffix"):
        (copy.folder / name).write_bytes(b"DOTS" + points.tobytes())
        exported = copy.gsgen("export", "static", name, "-o", f"{name}.onnx")
        assert exported.returncode == 0, exported.stdout + exported.stderr
        assert "4" in exported.stdout
    script = """
        from gsgen.formats import open_splats, read_dots
        assert (open_splats("points.dots").position == read_dots("points.dots").position).all()
    """
    completed = copy.run("-c", dedent(script))
    assert completed.returncode == 0, completed.stderr


def test_a_target_touches_the_place_of_the_page(copy: Copy) -> None:
    copy.take("contract/gsgen")
    (folder,) = _PATHS_BY_EXTENSION["target"]
    target = json.loads((ROOT / folder / "gsgen.json").read_text("utf-8"))
    changes = {"name": "acme", "opset": [13, 17], "follows_runtime": False}
    copy.write(f"{folder}/acme.json", json.dumps(target | changes))
    copy.assert_touches_only("target")
    onnx.save(still().build(), copy.folder / "model.onnx")  # operator set 18
    completed = copy.gsgen("validate", "model.onnx", "--target", "acme", "--json")
    findings = json.loads(completed.stdout)["findings"]
    assert completed.returncode == 1, completed.stderr
    assert [finding["rule"] for finding in findings] == ["GG001"]
