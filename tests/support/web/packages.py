"""Packages of npm that tests use; scripts/fetch.sh fetches them."""

import os
from pathlib import Path
from shutil import which

import pytest

from support.commands import ROOT


def require_node() -> str:
    """Return the path of Node.js; without it, fail the test in CI, and skip it elsewhere."""
    path = which("node")
    if path is None:
        if os.environ.get("CI"):
            pytest.fail("missing: node on the PATH")
        pytest.skip("missing: node on the PATH")
    return path


def package(name: str, *, needs_node: bool = False) -> Path:
    """Return a package's folder; without it, fail the test in CI, and skip it elsewhere.

    Args:
        name: Name and version, such as ``three-0.180.0``.
        needs_node: Whether the package is run by Node.js.
    """
    folder = ROOT / ".venv/npm" / name
    part = "peers" if name == "peers" else "browser"
    missing = [] if folder.is_dir() else [f"{name} (run scripts/fetch.sh {part})"]
    missing += ["node on the PATH"] if needs_node and which("node") is None else []
    if missing:
        message = f"missing: {' and '.join(missing)}"
        if os.environ.get("CI"):
            pytest.fail(message)
        pytest.skip(message)
    return folder
