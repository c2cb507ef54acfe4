"""Check that the working tree may be released: version, changelog, placeholders, tag, changes.

Prints every fault with its place and exits 1 if there is one, else the tag of the release.

    .venv/bin/python scripts/release/check_release.py
"""

import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PLACEHOLDER = "OWNER/gsgen"
"""Stands for the repository until `make owner` has written its name."""
PLACEHOLDER_FILES = (
    "CITATION.cff",
    "README.md",
    "RELEASING.md",
    "action.yml",
    "docs/guides/test-your-plugin-in-ci.md",
    "docs/guides/validate-in-ci.md",
    "docs/index.md",
    "pyproject.toml",
)
"""The files that may hold the placeholder."""


def main() -> int:
    """Print the faults of this working tree, and return the exit code."""
    version = project_version(ROOT)
    faults = [*text_faults(ROOT, version), *git_faults(ROOT, version)]
    for fault in faults:
        print(f"check_release: {fault}", file=sys.stderr)
    if not faults:
        print(f"v{version}")
    return 1 if faults else 0


def project_version(root: Path) -> str:
    """Return the version of pyproject.toml."""
    document = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))
    return str(document["project"]["version"])


def text_faults(root: Path, version: str) -> Iterator[str]:
    """Yield the faults of the version, the changelog, the citation and the addresses."""
    if not re.fullmatch(r"\d+\.\d+\.\d+((a|b|rc)\d+)?", version):
        yield f"pyproject.toml: version {version!r}; expected three numbers, such as 1.2.3 or 1.2.3rc1"
    changelog = (root / "CHANGELOG.md").read_text("utf-8")
    if not re.search(rf"^## {re.escape(version)} - \d{{4}}-\d\d-\d\d$", changelog, re.MULTILINE):
        yield f"CHANGELOG.md: no section '## {version} - YYYY-MM-DD'; rename 'Unreleased'"
    citation = (root / "CITATION.cff").read_text("utf-8")
    if f"\nversion: {version}\n" not in citation:
        yield f"CITATION.cff: another version than {version}"
    for name in PLACEHOLDER_FILES:
        if PLACEHOLDER in (root / name).read_text("utf-8"):
            yield f"{name}: holds the placeholder {PLACEHOLDER}; run `make owner OWNER=name`"


def git_faults(root: Path, version: str) -> Iterator[str]:
    """Yield changes that are not committed, and a tag that exists."""
    if _git(root, "status", "--porcelain"):
        yield "the working tree has changes; commit them"
    if _git(root, "tag", "--list", f"v{version}"):
        yield f"the tag v{version} exists; raise the version in pyproject.toml"


def _git(root: Path, *words: str) -> str:
    command = ["git", *words]
    result = subprocess.run(command, cwd=root, capture_output=True, encoding="utf-8", check=True)
    return result.stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
