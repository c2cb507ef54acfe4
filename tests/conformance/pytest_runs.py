"""Folders with example models, and pytest as an author of a plugin runs it."""

import os
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from gsgen.conformance.fixtures import find


@dataclass(frozen=True, slots=True)
class Tested:
    """A finished run of pytest."""

    code: int
    out: str
    cases: dict[str, ElementTree.Element]

    @property
    def counts(self) -> Counter[str]:
        return Counter(outcome(case) for case in self.cases.values())

    def names(self, expected: str) -> list[str]:
        return [name for name, case in self.cases.items() if outcome(case) == expected]


def outcome(case: ElementTree.Element) -> str:
    for word in ("failure", "error"):
        if case.find(word) is not None:
            return word
    skipped = case.find("skipped")
    if skipped is None:
        return "passed"
    return "xfailed" if skipped.get("type") == "pytest.xfail" else "skipped"


def property_of(case: ElementTree.Element, name: str) -> str:
    actual = case.find(f"./properties/property[@name='{name}']")
    return "" if actual is None else actual.get("value", "")


def run_pytest(folder: Path, *words: str | Path) -> Tested:
    """Run pytest in ``folder`` with nothing but our plugin, unless more are named."""
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTEST")}
    clean |= {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "COLUMNS": "200"}
    command = [sys.executable, "-m", "pytest", "-p", "gsgen.conformance.pytest.plugin"]
    command += ["-p", "no:cacheprovider", "--junitxml=junit.xml", "-rA"]
    command += [f"--basetemp={folder / '.tmp'}", *map(str, words)]
    completed = subprocess.run(
        command, capture_output=True, text=True, cwd=folder, env=clean, timeout=120
    )
    xml = folder / "junit.xml"
    cases = {}
    if xml.exists():
        for case in ElementTree.parse(xml).iter("testcase"):
            cases[f"{case.get('classname')}::{case.get('name')}"] = case
    return Tested(completed.returncode, completed.stdout + completed.stderr, cases)


def write(folder: Path, *names: str) -> list[Path]:
    """Write example models into ``folder``."""
    return [find(name).write(folder) for name in names]
