"""The page reads a lod-meta.json as Python does: the same chains of tiles, errors and refusals."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.format.tileset import Tile
from gsgen.tiles.loading.tileset_loader import open_tileset
from support.web.packages import package
from support.web.pages import CLIENT

_SCRIPT = """
import { readFileSync } from "node:fs";
const { tilesetOf } = await import(process.argv[1]);
const documents = JSON.parse(readFileSync(process.argv[2]));
const chain = ({ level = 0, geometricError, rows, content, children }) =>
  [level, geometricError, rows, content?.uri, children.map(chain)];
const told = (document) => tilesetOf(document, "https://a/lod-meta.json").then(({ root }) => chain(root), () => null);
console.log(JSON.stringify(await Promise.all(documents.map(told))));
"""


def described(tile: Tile) -> list[Any]:
    """Return what the script above tells of a tile."""
    (content,) = tile.contents or (None,)
    rows = content and content.rows
    span = [rows.start, rows.stop - rows.start] if rows and rows.stop else None
    uri = content and content.uri
    children = [described(child) for child in tile.children]
    return [tile.level or 0, tile.geometric_error, span, uri, children]


def rounded(tile: list[Any]) -> list[Any]:
    """Return a description with errors of 9 digits."""
    level, error, rows, uri, children = tile
    return [level, float(f"{error:.9g}"), rows, uri, [rounded(child) for child in children]]


def random_document(rng: np.random.Generator) -> dict[str, Any]:
    """Return a tree whose leaves lack levels, or have some without rows or told errors."""
    leaves = []
    for _ in range(int(rng.integers(1, 5))):
        levels = rng.permutation(4)[: rng.integers(1, 5)].tolist()
        counts = rng.choice([0, 3, 40], len(levels)).tolist()
        counts[int(rng.integers(len(levels)))] = 7
        low = rng.uniform(-5, 0, 3)
        leaf: dict[str, Any] = {
            "bound": {"min": low.tolist(), "max": (low + rng.uniform(0, 3, 3)).tolist()},
            "lods": {
                str(level): {"file": level % 2, "offset": 2 * level, "count": count}
                for level, count in zip(levels, counts, strict=True)
            },
        }
        if rng.uniform() < 0.5:
            leaf["errors"] = rng.uniform(0, 1, int(rng.integers(1, 5))).tolist()
        leaves.append(leaf)
    tree = {"children": [leaves[0], {"children": leaves[1:]}]} if len(leaves) > 1 else leaves[0]
    return {"lodLevels": 4, "filenames": ["a.sog", "b.sog"], "tree": tree}


def damaged_documents(rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return documents that are refused."""
    changes: tuple[dict[str, Any], ...] = (
        {"errors": [0, -1, -1, -1]},
        {"lods": {"0": {"file": 2, "offset": 0, "count": 1}}},
        {"lods": {"0": {"file": 0, "offset": 0, "count": 0}}},
        {"lods": {"0": None}},
        {"lods": {}},
        {"bound": {"min": [0, 0, 0]}},
    )
    documents = []
    for change in changes:
        document = random_document(rng)
        lods = {str(level): {"file": 0, "offset": 0, "count": 5} for level in range(4)}
        bound = {"min": [0, 0, 0], "max": [1, 1, 1]}
        document["tree"] = {"bound": bound, "lods": lods} | change
        documents.append(document)
    return documents


def test_trees_are_the_same_chains_of_tiles(tmp_path: Path) -> None:
    package("types-0.1.74", needs_node=True)  # Node.js is there where other packages are
    rng = np.random.default_rng(5)
    documents = [random_document(rng) for _ in range(40)]
    damaged = damaged_documents(rng)
    (tmp_path / "documents.json").write_text(json.dumps([*documents, *damaged]))
    module = (CLIENT / "streamed_sog.js").as_uri()
    command = ["node", "--input-type=module", "--eval", _SCRIPT, module, "documents.json"]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.stderr == ""
    told = json.loads(result.stdout)
    for document, actual in zip(documents, told, strict=False):
        (tmp_path / "lod-meta.json").write_text(json.dumps(document))
        expected = described(open_tileset(tmp_path / "lod-meta.json").root)
        assert rounded(actual) == rounded(expected)
    assert told[len(documents) :] == [None] * len(damaged)
    for document in damaged:
        (tmp_path / "lod-meta.json").write_text(json.dumps(document))
        with pytest.raises(TilesetInvalid):
            open_tileset(tmp_path / "lod-meta.json")
