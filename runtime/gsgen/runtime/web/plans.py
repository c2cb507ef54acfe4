"""The document ``plans.json``: all frame plans and uniforms that the browser client uses."""

__all__ = ["PLANS_FILE", "SHAPES", "plans_document", "plans_text", "written_plans"]

import json
from collections.abc import Mapping
from importlib.resources import files
from itertools import product
from typing import Any, Final

import numpy as np

from gsgen.runtime.gpu.device import MOST_GROUPS
from gsgen.runtime.gpu.splat_residency import PAGE_ROWS
from gsgen.runtime.kernels.project.project import FRAME, NO_HARMONICS, PAGE
from gsgen.runtime.kernels.shared.counts import BYTES, Counts
from gsgen.runtime.kernels.shared.shader import JACOBIAN_MARGIN, TILE, source
from gsgen.runtime.kernels.tiles.tile_ranges import RANGE_BLOCK
from gsgen.runtime.renderer.renderer import FIRST_PAIRS, PAIRS_ROOM
from gsgen.runtime.scene.frame import Output
from gsgen.runtime.viewer.present import SHOWING, SHOWING_CONSTANTS
from gsgen.runtime.web.plan_tables import PlanTables, module_row
from gsgen.runtime.web.recording import APPEARANCES, Shape, record
from gsgen.runtime.web.recording_device import RecordedModule

PLANS_FILE: Final = "gsgen.runtime.web:client/plans.json"
"""Package and path of the written document."""

_OUTPUTS: Final[tuple[tuple[Output, ...], ...]] = (
    ("color",),
    ("depth",),
    ("normal",),
    ("color", "depth"),
)
_SIZES: Final = (64, 256, 1024, 4096)
"""Sides of the largest square images whose tiles are sorted in one, two, three and four passes."""

SHAPES: Final = tuple(
    Shape(outputs=outputs, panorama=panorama, deep=deep, size=(side, side))
    for outputs, panorama, deep, side in product(_OUTPUTS, (False, True), (False, True), _SIZES)
)
"""The shapes of all plans; of equal plans the one for smaller images comes first."""


def plans_document() -> dict[str, Any]:
    """Return the frame plans, uniforms and constants of the renderer as one JSON object."""
    tables = PlanTables()
    for shape in SHAPES:
        tables.add(record(shape))
    present = RecordedModule("present", source("present", **SHOWING_CONSTANTS))
    module = tables.row("modules", module_row(tables, present))
    return {
        "plans": tables.plans,
        **tables.tables,
        "uniforms": {"frame": _fields(FRAME), "page": _fields(PAGE), "showing": _fields(SHOWING)},
        "counts": {member.name: int(member) for member in Counts} | {"BYTES": BYTES},
        "appearances": [
            {
                "kind": f"{'float16' if each.half else 'float32'} {each.stride}",
                "dtype": "float16" if each.half else "float32",
                "channels": each.channels,
                "bytes": 16 * each.stride or 8,
            }
            for each in APPEARANCES
        ],
        "pairs": {"first": FIRST_PAIRS, "room": PAIRS_ROOM, "most": MOST_GROUPS * RANGE_BLOCK},
        "present": {
            "module": module,
            "vertex": "corner_of",
            "fragment": "color_at",
            "modes": {"color": 0} | SHOWING_CONSTANTS,
        },
        "constants": {
            "TILE": TILE,
            "JACOBIAN_MARGIN": JACOBIAN_MARGIN,
            "NO_HARMONICS": NO_HARMONICS,
            "PAGE_ROWS": PAGE_ROWS,
        },
    }


def _fields(dtype: np.dtype[np.void]) -> dict[str, Any]:
    """Return the byte size of a uniform struct, and type, shape and offset of each field."""
    assert dtype.fields is not None
    fields: Mapping[str, Any] = dtype.fields
    return {
        "size": dtype.itemsize,
        "fields": {
            name: [field[0].base.str[1:], list(field[0].shape), field[1]]
            for name, field in fields.items()
        },
    }


def plans_text() -> str:
    """Return the text of ``plans.json``, with one table row a line, so that diffs are readable."""
    lines = []
    for key, value in plans_document().items():
        if isinstance(value, list):
            rows = ",\n".join(json.dumps(row, separators=(",", ":")) for row in value)
            lines.append(f'"{key}":[\n{rows}]')
        else:
            lines.append(f'"{key}":{json.dumps(value, separators=(",", ":"))}')
    return "{\n" + ",\n".join(lines) + "}\n"


def written_plans() -> str:
    """Return the text of the installed ``plans.json``."""
    package, _, path = PLANS_FILE.partition(":")
    return files(package).joinpath(path).read_text("utf-8")
