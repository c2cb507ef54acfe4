"""Files of other projects: what gsgen says of each, compared with committed verdicts.

The files are never copied here. Each corpus is a folder of a checkout, below the folder that the
environment variable GSGEN_CORPORA names: 3d-tiles-validator, splat-transform and trimesh.
To write the verdicts after a change: PYTHONPATH=tests python -m corpora.strangers FOLDER
"""

import os
import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

from gsgen.contract import Level
from gsgen.contract.errors import GsgenError
from gsgen.contract.validation.settings import Settings
from gsgen.runtime.sources.mesh_source import MeshSource
from gsgen.runtime.sources.opening import open_source
from gsgen.tiles.validation.validate import validate

VERDICTS = Path(__file__).with_name("verdicts")
# Corpus → folder of its checkout, and the function that judges its files.
CORPORA = {
    "3d-tiles-validator": "specs/data/tilesets",
    "splat-transform": "test/fixtures/splat",
    "trimesh": "models",
}
_EXPECTATION = re.compile(r'"specs/data/tilesets/([^"]+)".*?(?=\n  it\(|\Z)', re.DOTALL)
_WARNING_TYPES = {
    "CONTENT_VALIDATION_INFO",
    "CONTENT_VALIDATION_WARNING",
    "EXTENSION_NOT_SUPPORTED",
    "EXTENSION_USED_BUT_NOT_FOUND",
    "METADATA_SEMANTIC_UNKNOWN",
    "TYPE_UNEXPECTED",
}


def corpus_folder(name: str) -> Path:
    """Return the folder of a corpus, or skip the test where it is absent."""
    root = os.environ.get("GSGEN_CORPORA")
    if not root:
        pytest.skip("GSGEN_CORPORA names no folder of checkouts")
    folder = Path(root) / name
    if not (folder / CORPORA[name]).is_dir():
        pytest.skip(f"no {CORPORA[name]} in {folder}")
    return folder


def verdicts_of(name: str, folder: Path) -> dict[str, str]:
    """Return file → verdict of a corpus; a verdict is a traceback only for a fault of gsgen."""
    if name == "3d-tiles-validator":
        return dict(_tileset_verdicts(folder))
    paths = sorted(path for path in (folder / CORPORA[name]).rglob("*") if path.is_file())
    return {
        path.relative_to(folder / CORPORA[name]).as_posix(): _opening_verdict(path)
        for path in paths
    }


def _opening_verdict(path: Path) -> str:
    """Open a file as `gsgen render` does."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # notes on what is missing or not used
        try:
            source = open_source(path)
        except GsgenError as error:
            return f"refused: {type(error).__name__}"
        except Exception as error:
            return f"traceback: {type(error).__name__}: {error}"[:100]
    if isinstance(source, MeshSource):
        return f"{sum(len(mesh.data.faces) for mesh in source.meshes)} triangles"
    return f"{source.count} splats"


def _tileset_verdicts(folder: Path) -> Iterator[tuple[str, str]]:
    """Yield each tileset of the validator's own tests: our verdict, and whether it is theirs."""
    text = (folder / "specs" / "TilesetValidationSpec.ts").read_text()
    for match in _EXPECTATION.finditer(text):
        types = set(re.findall(r'type\)\.toEqual\(\s*"(\w+)"', match[0]))
        expected = "invalid" if types - _WARNING_TYPES else "conforms"
        try:
            path = folder / CORPORA["3d-tiles-validator"] / match[1]
            report = validate(path, Settings(level=Level.STATIC))
            rules = sorted({finding.rule for finding in report.findings})
            verdict = f"{report.verdict} {' '.join(rules)}".strip()
        except GsgenError as error:
            verdict = f"invalid {type(error).__name__}"
        except Exception as error:
            verdict = f"traceback: {type(error).__name__}: {error}"[:100]
        agreement = "agreed" if verdict.split()[0] == expected else f"theirs: {expected}"
        yield match[1], f"{verdict}; {agreement}"


def committed(name: str) -> dict[str, str]:
    """Return file → committed verdict of a corpus."""
    lines = (VERDICTS / f"{name}.txt").read_text().splitlines()
    return dict(line.split("\t", 1) for line in lines if not line.startswith("#"))


def main(root: Path) -> None:
    """Write the verdicts of the corpora that are there."""
    for name, part in CORPORA.items():
        if not (root / name / part).is_dir():
            print(f"{name}: no {part} in {root / name}")
            continue
        verdicts = verdicts_of(name, root / name)
        lines = [f"{file}\t{verdict}\n" for file, verdict in sorted(verdicts.items())]
        (VERDICTS / f"{name}.txt").write_text("".join(lines))
        print(f"{name}: {len(lines)} files")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
