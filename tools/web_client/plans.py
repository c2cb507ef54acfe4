"""The document ``plans.json``: GPU buffers, dispatches and uniforms for the browser client."""

__all__ = ["SHAPES", "plans_document", "plans_text", "pool_kinds"]

import json
from collections.abc import Mapping
from itertools import product
from typing import Any, Final

import numpy as np

from gsgen.contract.spec.layout import ROW_LENGTH
from gsgen.runtime.gpu.device import MAX_WORKGROUPS, Device
from gsgen.runtime.gpu.splat_residency import PAGE_ROWS, appearance_stride
from gsgen.runtime.kernels.project.project import FRAME, NO_HARMONICS, PAGE
from gsgen.runtime.kernels.project.slots import SLOT_UNIFORM_DTYPE
from gsgen.runtime.kernels.shared.counts import COUNTERS_BYTES, Counts
from gsgen.runtime.kernels.shared.kernel import THREADS_PER_WORKGROUP
from gsgen.runtime.kernels.shared.shader import JACOBIAN_MARGIN, TILE, source
from gsgen.runtime.kernels.tiles.tile_ranges import RANGE_BLOCK
from gsgen.runtime.playback.post_process import TILE_OVERLAP
from gsgen.runtime.renderer.renderer import FIRST_PAIR_CAPACITY, PAIR_CAPACITY_FACTOR
from gsgen.runtime.scene.frame import Output
from gsgen.runtime.scene.splat_pool import SLOT_ROWS
from gsgen.runtime.sources.stream_settings import StreamSettings
from gsgen.runtime.viewer.present import PRESENT_CONSTANTS, PRESENT_UNIFORM
from gsgen.tiles.prediction.predictor import TURN_SECONDS, VELOCITY_WINDOW
from gsgen.tiles.prediction.prefetch import (
    HORIZON_FRACTIONS,
    PLAN_INTERVAL_SECONDS,
    PREDICTION_HORIZON,
)
from gsgen.tiles.streaming.drawing import FADE_SECONDS, MAX_STEP_SECONDS
from gsgen.tiles.streaming.fetch import RETRY_AFTER
from gsgen.tiles.streaming.planner import (
    CANCEL_PRIORITY_FRACTION,
    MAX_UNSEEN_FRACTION,
    MAX_WASTE_FRACTION,
)
from web_client.browser_kernels import (
    IMAGE_TILE,
    PICTURE,
    ImageTensors,
    ImportLayer,
    LiveCounts,
    RepackRows,
)
from web_client.formulas import Formula
from web_client.plan_tables import PlanTables, module_row
from web_client.recording import APPEARANCES, Shape, page_kind, record, recorded_pool_pages
from web_client.recording_device import RecordedModule, RecordingDevice

_OUTPUTS: Final[tuple[tuple[Output, ...], ...]] = (
    ("color",),
    ("depth",),
    ("normal",),
    ("color", "depth"),
)
_SIZES: Final = {False: (512, 8192), True: (256, 4096)}
"""Sides of the largest square images whose tiles are sorted in one pass and in two.

Weighted sums have smaller tiles.
"""

_BOTH: Final = (False, True)

LAYERS: Final = 2
"""Image layers of a web page's other renderer: translucent surfaces, and those behind them."""

SHAPES: Final = tuple(
    Shape(outputs=outputs, weighted=weighted, panorama=panorama, deep=deep, size=(side, side))
    for outputs, weighted, panorama, deep in product(_OUTPUTS, _BOTH, _BOTH, _BOTH)
    for side in _SIZES[weighted]
) + tuple(
    Shape(outputs=outputs, layers=LAYERS, deep=deep, size=(side, side))
    for outputs, deep, side in product(_OUTPUTS[:2], _BOTH, _SIZES[False])
)
"""The shapes of all plans; of equal plans the one for smaller images comes first."""


def plans_document() -> dict[str, Any]:
    """Return recorded GPU plans, uniforms and constants of the renderer as a JSON object."""
    tables = PlanTables()
    for shape in SHAPES:
        tables.add(record(shape))
    present = RecordedModule("present", source("present", **PRESENT_CONSTANTS))
    module = tables.row("modules", module_row(tables, present))
    generators = _generator_kernels(tables)
    importing = ImportLayer(Device(RecordingDevice())).kernel
    layers = {
        "count": LAYERS,
        "pipeline": tables.pipeline(importing.pipeline),
        "groups": [["ceil_div", "width", TILE], ["ceil_div", "height", TILE], 1],
    }
    return {
        "plans": tables.plans,
        **tables.tables,
        "uniforms": {
            "frame": _fields(FRAME),
            "page": _fields(PAGE),
            "showing": _fields(PRESENT_UNIFORM),
            "picture": _fields(PICTURE),
            "region": _fields(IMAGE_TILE),
            "slot": _fields(SLOT_UNIFORM_DTYPE),
        },
        "counts": {member.name: int(member) for member in Counts} | {"BYTES": COUNTERS_BYTES},
        "appearances": [
            {
                "kind": f"{'float16' if each.half else 'float32'} {each.appearance_stride}",
                "dtype": "float16" if each.half else "float32",
                "channels": each.channels,
                "bytes": 16 * each.appearance_stride or 8,
            }
            for each in APPEARANCES
        ],
        "generators": generators,
        "layers": layers,
        "posts": _post_kernels(tables),
        "pools": pool_kinds(tables),
        "pairs": {
            "first": FIRST_PAIR_CAPACITY,
            "room": PAIR_CAPACITY_FACTOR,
            "most": MAX_WORKGROUPS * RANGE_BLOCK,
        },
        "streaming": {
            "slotRows": SLOT_ROWS,
            "maxError": StreamSettings().max_error,
            "requests": StreamSettings().connections,
            "cancelFraction": CANCEL_PRIORITY_FRACTION,
            "wasteFraction": MAX_WASTE_FRACTION,
            "unseenFraction": MAX_UNSEEN_FRACTION,
            "horizonSeconds": PREDICTION_HORIZON,
            "horizonFractions": list(HORIZON_FRACTIONS),
            "planSeconds": PLAN_INTERVAL_SECONDS,
            "velocitySeconds": VELOCITY_WINDOW,
            "turnSeconds": TURN_SECONDS,
            "retrySeconds": RETRY_AFTER,
            "fadeSeconds": FADE_SECONDS,
            "fadeStep": MAX_STEP_SECONDS,
        },
        "present": {
            "module": module,
            "vertex": "corner_of",
            "fragment": "color_at",
            "modes": {"color": 0} | PRESENT_CONSTANTS,
        },
        "constants": {
            "JACOBIAN_MARGIN": JACOBIAN_MARGIN,
            "NO_HARMONICS": NO_HARMONICS,
            "PAGE_ROWS": PAGE_ROWS,
        },
    }


def pool_kinds(tables: PlanTables, slot_rows: int = SLOT_ROWS) -> dict[str, Any]:
    """Return a splat pool's GPU buffers for each data format; sizes are formulas of ``slots``."""
    device, slots = Device(RecordingDevice()), Formula(1, "slots", [])
    placed = recorded_pool_pages(device, APPEARANCES, [slots] * len(APPEARANCES), slot_rows)
    return {page_kind(page): tables.pool_buffers(page, "slots") for _, page in placed}


def _generator_kernels(tables: PlanTables) -> dict[str, Any]:
    """Return JSON of the GPU kernels that repack model outputs, by dtype and number of channels.

    Outputs that pages can bind as they are have none.
    """
    device = Device(RecordingDevice())
    repacks = []
    sources = [("float16", ROW_LENGTH, "rows")]
    sources += [
        (dtype, channels, "appearance")
        for dtype in ("float32", "float16")
        for channels in (3, 4, 12, 27, 48)
    ]
    for dtype, columns, target in sources:
        half = dtype == "float16"
        is_row = target == "rows"
        words = ROW_LENGTH if is_row else (4 * appearance_stride(columns, is_half=half) or 2)
        if columns * (2 if half else 4) == 4 * words:
            continue
        kernel = RepackRows(
            device, columns, words, half_source=half, half_target=half and not is_row
        ).kernel
        repacks.append(
            {
                "target": target,
                "dtype": dtype,
                "columns": columns,
                "words": words,
                "pipeline": tables.pipeline(kernel.pipeline),
                "groups": [["ceil_div", "capacity", THREADS_PER_WORKGROUP], 1, 1],
            }
        )
    live = LiveCounts(device).kernel
    counts = {"pipeline": tables.pipeline(live.pipeline), "groups": [1, 1, 1]}
    return {"repacks": repacks, "live_counts": counts}


def _post_kernels(tables: PlanTables) -> dict[str, Any]:
    """Return JSON of the GPU kernels between images and the tensors of networks, by dtype."""
    device = Device(RecordingDevice())
    tiles = [["ceil_div", side, TILE] for side in ("width", "height")]
    kernels = {}
    for dtype in ("float32", "float16"):
        own = ImageTensors(device, half=dtype == "float16")
        kernels[dtype] = {
            "fill": {
                "pipeline": tables.pipeline(own.fill.pipeline),
                "groups": [["ceil_div", "groups", "rows"], "rows", 1],
            },
            "add": {"pipeline": tables.pipeline(own.add.pipeline), "groups": [*tiles, 1]},
            "finish": {"pipeline": tables.pipeline(own.finish.pipeline), "groups": [*tiles, 1]},
        }
    return {"kernels": kernels, "threads": THREADS_PER_WORKGROUP, "overlap": TILE_OVERLAP}


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
    """Return the text of ``plans.json`` with one table row per line, so that diffs are readable."""
    lines = []
    for key, value in plans_document().items():
        if isinstance(value, list):
            rows = ",\n".join(json.dumps(row, separators=(",", ":")) for row in value)
            lines.append(f'"{key}":[\n{rows}]')
        else:
            lines.append(f'"{key}":{json.dumps(value, separators=(",", ":"))}')
    return "{\n" + ",\n".join(lines) + "}\n"
