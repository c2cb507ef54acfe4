"""Texts that are kept beside the tests, and compared character by character."""

import os
from pathlib import Path

FOLDER = Path(__file__).parents[2] / "contract" / "goldens"


def assert_is_golden(name: str, text: str) -> None:
    """Compare with ``goldens/name``; with GSGEN_WRITE_GOLDENS=1, write it instead."""
    path = FOLDER / name
    if os.environ.get("GSGEN_WRITE_GOLDENS") == "1":
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, "utf-8")
    assert path.exists(), f"no {path}: run the test once with GSGEN_WRITE_GOLDENS=1"
    assert text == path.read_text("utf-8")
