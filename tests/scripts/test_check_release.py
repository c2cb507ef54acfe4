"""What stops a release before anything is built."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.commands import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
import release

NAMES = (*release.PLACEHOLDER_FILES, "CHANGELOG.md", "Makefile")


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A copy that may be released."""
    for name in NAMES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
        text = (tmp_path / name).read_text("utf-8")
        (tmp_path / name).write_text(text.replace("OWNER/gsgen", "acme/gsgen"), "utf-8")
    version = release.project_version(tmp_path)
    change(
        tmp_path / "CHANGELOG.md", "## Unreleased", f"## Unreleased\n\n## {version} - 2026-12-01"
    )
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-qm", "Release")
    return tmp_path


def git(folder: Path, *words: str) -> None:
    identity_options = ("-c", "user.name=a", "-c", "user.email=a@b.c")
    subprocess.run(["git", *identity_options, *words], cwd=folder, check=True)


def change(path: Path, before: str, after: str) -> None:
    text = path.read_text("utf-8")
    assert before in text
    path.write_text(text.replace(before, after), "utf-8")


def faults(project: Path) -> list[str]:
    version = release.project_version(project)
    return [*release.text_faults(project, version), *release.git_faults(project, version)]


def test_a_complete_tree_may_be_released(project: Path) -> None:
    assert faults(project) == []


@pytest.mark.parametrize(
    ("name", "before", "after", "fault"),
    [
        ("CHANGELOG.md", " - 2026-12-01", "", "CHANGELOG.md: no section"),
        ("pyproject.toml", 'version = "', 'version = "next', "expected three numbers"),
        ("CITATION.cff", "\nversion: ", "\nversion: 9", "CITATION.cff: another version"),
        ("README.md", "# gsgen", "# OWNER/gsgen", "README.md: holds the placeholder"),
        ("mkdocs.yml", "com/acme/", "com/b/", "mkdocs.yml: names b/gsgen, but pyproject.toml acme"),
        ("action.yml", "uses: acme/", "uses: b/", "action.yml: names b/gsgen"),
        ("conda/recipe.yaml", 'version: "', 'version: "9', "conda/recipe.yaml: another version"),
    ],
)
def test_a_fault_is_named(project: Path, name: str, before: str, after: str, fault: str) -> None:
    change(project / name, before, after)
    actual = faults(project)
    assert any(fault in text for text in actual), actual
    assert "the working tree has changes; commit them" in actual


def test_a_tag_is_not_used_twice(project: Path) -> None:
    git(project, "tag", f"v{release.project_version(project)}")
    assert [text.partition(";")[0] for text in faults(project)] == [
        f"the tag v{release.project_version(project)} exists"
    ]


def test_the_placeholder_is_in_no_other_file() -> None:
    command = ["git", "grep", "-lI", release.PLACEHOLDER]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, encoding="utf-8").stdout
    tools = {"Makefile", "scripts/release.py"}
    files = {name for name in listed.splitlines() if not name.startswith("tests/")} - tools
    assert files <= set(release.PLACEHOLDER_FILES)


def test_the_owner_is_written_into_every_file(project: Path) -> None:
    for name in (*release.PLACEHOLDER_FILES, "Makefile"):
        shutil.copy(ROOT / name, project / name)
    subprocess.run(["make", "-s", "owner", "OWNER=acme"], cwd=project, check=True)
    assert not [text for text in faults(project) if "placeholder" in text]
    assert "github.com/acme/gsgen" in (project / "pyproject.toml").read_text("utf-8")
    missing = subprocess.run(["make", "-s", "owner"], cwd=project, capture_output=True)
    assert missing.returncode == 2
