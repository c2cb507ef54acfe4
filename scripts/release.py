"""Check a release: the working tree before the build, and the wheel after it.

    python scripts/release.py tree          version, changelog, placeholders, tag, changes
    python scripts/release.py wheel FOLDER  installs the wheel of a folder, measures and runs it

`tree` prints every fault with its place, or else the tag of the release. `wheel` compares the size
of a new environment with the bar, and validates a good and a broken model there. Both exit 1 at a
fault.
"""

import json
import re
import subprocess
import sys
import tempfile
import tomllib
import venv
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PLACEHOLDER = "OWNER/gsgen"
"""Stands for the repository until `make owner` has written its name."""
PLACEHOLDER_FILES = (
    "CITATION.cff",
    "README.md",
    "RELEASING.md",
    "action.yml",
    "conda/recipe.yaml",
    "docs/guides/test-your-plugin-in-ci.md",
    "docs/guides/validate-in-ci.md",
    "docs/index.md",
    "docs/install.md",
    "mkdocs.yml",
    "pyproject.toml",
)
"""The files that may hold the placeholder, and have the addresses of the repository."""
_ADDRESS = re.compile(r"(?:github\.com/|(?:uses|repo): )([\w.-]+/gsgen)\b")
MOST_MEGABYTES = 250
"""The bar for an environment with the base wheel, in MiB, with pip."""
WRITE_MODEL = """
import sys
from pathlib import Path
from gsgen.conformance.fixtures import find
print(find(sys.argv[1]).write(Path()))
"""
EXPECTED = {"drift": (0, "conforms"), "opacity_is_logits": (1, "invalid")}
"""Example models, and the exit code and verdict of each."""


def check_tree() -> int:
    """Print the faults of this working tree, and return the exit code."""
    version = project_version(ROOT)
    faults = [*text_faults(ROOT, version), *git_faults(ROOT, version)]
    for fault in faults:
        print(f"release: {fault}", file=sys.stderr)
    if not faults:
        print(f"v{version}")
    return 1 if faults else 0


def project_version(root: Path) -> str:
    """Return the version of pyproject.toml."""
    document = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))
    return str(document["project"]["version"])


def repository(root: Path) -> str:
    """Return OWNER/NAME of the repository: the address in pyproject.toml, which names the owner."""
    document = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))
    return str(document["project"]["urls"]["Repository"]).removeprefix("https://github.com/")


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
    if f'\n  version: "{version}"\n' not in (root / "conda/recipe.yaml").read_text("utf-8"):
        yield f"conda/recipe.yaml: another version than {version}"
    for name in PLACEHOLDER_FILES:
        text = (root / name).read_text("utf-8")
        if PLACEHOLDER in text:
            yield f"{name}: holds the placeholder {PLACEHOLDER}; run `make owner OWNER=name`"
        for other in sorted({*_ADDRESS.findall(text)} - {repository(root)}):
            yield f"{name}: names {other}, but pyproject.toml {repository(root)}"


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


def check_wheel(dist: Path) -> int:
    """Check the wheel in the folder ``dist``, and return the exit code."""
    wheels = sorted(dist.resolve().glob("gsgen-*.whl"))
    if len(wheels) != 1:
        print(f"{dist}: {len(wheels)} wheels of gsgen; expected 1", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="gsgen-wheel-") as name:
        return _check_installed(wheels[0], Path(name))


def _check_installed(wheel: Path, folder: Path) -> int:
    """Install ``wheel`` below ``folder``, and return the exit code of the checks."""
    venv.create(folder / "venv", with_pip=True)
    binaries = folder / "venv" / ("Scripts" if sys.platform == "win32" else "bin")
    python = binaries / "python"
    constraints = ROOT / "constraints.txt"
    pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-compile"]
    _run([*pip, "-c", constraints, wheel], folder)
    size = sum(file.stat().st_size for file in folder.rglob("*") if not file.is_symlink())
    megabytes = size / 2**20
    print(f"{wheel.name}: {megabytes:.0f} MiB installed; bar {MOST_MEGABYTES}")
    program = binaries / "gsgen"
    print(_run([program, "--version"], folder).strip())
    verdicts = [_verdict(program, python, name, folder) for name in EXPECTED]
    return 0 if megabytes <= MOST_MEGABYTES and all(verdicts) else 1


def _verdict(program: Path, python: Path, name: str, folder: Path) -> bool:
    code, verdict = EXPECTED[name]
    model = _run([python, "-c", WRITE_MODEL, name], folder).strip()
    report = json.loads(_run([program, "validate", model, "--json"], folder, code))
    print(f"{name}: {report['verdict']}; expected {verdict}")
    return bool(report["verdict"] == verdict)


def _run(command: list[str | Path], folder: Path, expected: int = 0) -> str:
    result = subprocess.run(command, cwd=folder, capture_output=True, encoding="utf-8")
    if result.returncode != expected:
        words = " ".join(map(str, command))
        sys.exit(f"`{words}` exits {result.returncode}; expected {expected}\n{result.stderr}")
    return result.stdout


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["tree"]:
            sys.exit(check_tree())
        case ["wheel", folder]:
            sys.exit(check_wheel(Path(folder)))
        case _:
            sys.exit(f"usage: {sys.argv[0]} tree, or wheel FOLDER")
