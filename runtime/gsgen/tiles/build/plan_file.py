"""Saves and loads the plan of a tileset build, ``plan.json``, which every worker reads."""

__all__ = ["load_plan", "save_plan"]

from collections.abc import Mapping
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

from gsgen.formats.merging.morton import Cube
from gsgen.formats.ply.chunks import PlyTable
from gsgen.tiles.build.files import read_json, write_json
from gsgen.tiles.build.parameters import BuildParameters
from gsgen.tiles.build.plan import Partition, Plan
from gsgen.tiles.build.source import Chunk, SceneFile


def save_plan(plan: Plan, path: Path) -> None:
    """Write the plan of a tileset build to a file."""
    content = asdict(plan)
    content["files"] = [asdict(file) for file in _files(plan)]
    for chunk in content["chunks"]:
        chunk["file"] = next(
            index
            for index, file in enumerate(content["files"])
            if file["path"] == chunk["file"]["path"]
        )
    write_json(path, content)


def _files(plan: Plan) -> list[SceneFile]:
    return list({chunk.file.path: chunk.file for chunk in plan.chunks}.values())


@lru_cache(maxsize=2)
def load_plan(path: str) -> Plan:
    """Return the plan of a tileset build from a file, which each process reads once."""
    content = read_json(Path(path))
    files = [_file(item) for item in content.pop("files")]
    chunks = tuple(Chunk(**{**item, "file": files[item["file"]]}) for item in content["chunks"])
    parameters = content["parameters"]
    parameters["qualities"] = tuple(parameters["qualities"])
    parameters["transform"] = tuple(parameters["transform"])
    parameters["origin"] = parameters["origin"] and tuple(parameters["origin"])
    content |= {
        "chunks": chunks,
        "cube": Cube(tuple(content["cube"]["low"]), content["cube"]["side"]),
        "parameters": BuildParameters(**parameters),
        "partitions": tuple(
            Partition(**{**item, "locations": tuple(item["locations"])})
            for item in content["partitions"]
        ),
        "top": tuple(content["top"]),
    }
    return Plan(**content)


def _file(item: Mapping[str, Any]) -> SceneFile:
    table = item["table"]
    if table is not None:
        table = PlyTable(**{**table, "columns": tuple(table["columns"])})
    return SceneFile(**{**item, "table": table, "origin": tuple(item["origin"])})
