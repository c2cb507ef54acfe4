"""Writes the viewer test kit: models, expected pictures, index.json and a comparing script."""

__all__ = ["DrawFrames", "kit_cases", "picture_name", "write_kit"]

import json
import re
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from gsgen.conformance.viewer_kit import check_viewer, picture_files
from gsgen.conformance.viewer_kit.case import KitFrame, ViewerKitCase
from gsgen.conformance.viewer_kit.document import viewer_kit_schemas
from gsgen.conformance.viewer_kit.faults import VIEWER_FAULTS
from gsgen.conformance.viewer_kit.input_cases import INPUT_CASES
from gsgen.conformance.viewer_kit.row_cases import ROW_CASES
from gsgen.contract.process.atomic_files import atomic_write, require_new_folder

TOLERANCE: Final = {"pixel": 0.02, "share": 0.005, "mean": 0.001}
"""Largest difference of a channel, share of the pixels that may exceed it, and mean difference."""

TOLERANCE_8_BITS: Final = {"pixel": 0.024, "share": 0.005, "mean": 0.0025}
"""The tolerance of PNGs: a step of 1/255 more for a pixel, as rounding down takes up to it."""

_IMPORT_PATTERN = re.compile(rf"from {re.escape(picture_files.__name__)} import .*\n")

DrawFrames = Callable[[Path, Sequence[KitFrame]], Sequence[Float[np.ndarray, "h w 3"]]]


def kit_cases() -> tuple[ViewerKitCase, ...]:
    """Return all test cases of the viewer test kit, each with a model and the frames to draw."""
    return (*ROW_CASES, *INPUT_CASES)


def picture_name(case: str, number: int) -> str:
    """Return the file name, without suffix, of the picture of one frame of a viewer test."""
    return f"{case}-{number}"


def write_kit(folder: Path, draw: DrawFrames) -> Path:
    """Write the viewer test kit into ``folder``, and return the path of its index.json.

    Args:
        folder: A folder that does not exist, or is empty.
        draw: Draws the expected pictures, as gsgen.runtime.checks.viewer_kit.draw_frames does.

    Raises:
        ConfigInvalid: The folder holds files or is a file.
    """
    require_new_folder(folder)
    index_path = folder / "index.json"
    with atomic_write(index_path) as draft:
        for name in ("models", "expected"):
            (draft.parent / name).mkdir()
        document = _index_document([_write_case(draft.parent, case, draw) for case in kit_cases()])
        text = json.dumps(document, indent=1, ensure_ascii=False)
        draft.write_text(text + "\n", "utf-8")
        for name, schema in viewer_kit_schemas().items():
            text = json.dumps(schema, indent=1, ensure_ascii=False)
            (draft.parent / name).write_text(text + "\n", "utf-8")
        (draft.parent / "check_viewer.py").write_text(_script(), "utf-8")
    return index_path


def _script() -> str:
    """Return the comparing script, with the module that it imports in the import's place."""
    text = Path(check_viewer.__file__).read_text("utf-8")
    module = Path(picture_files.__file__).read_text("utf-8")
    script, count = _IMPORT_PATTERN.subn(lambda _: module, text)
    assert count == 1, "check_viewer.py imports picture_files on one line"
    return script


def _write_case(folder: Path, case: ViewerKitCase, draw: DrawFrames) -> dict[str, Any]:
    model = folder / "models" / f"{case.name}.onnx"
    case.spec().write(model)
    entries = []
    for number, (frame, picture) in enumerate(
        zip(case.frames, draw(model, case.frames), strict=True)
    ):
        name = picture_name(case.name, number)
        np.save(folder / "expected" / f"{name}.npy", picture.astype(np.float32))
        entries.append(_frame_entry(name, frame))
    entry = {"name": case.name, "tests": case.tests, "model": f"models/{model.name}"}
    broken_rules = {"breaks": list(case.breaks)} if case.breaks else {}
    return {**entry, **broken_rules, "faults": list(case.faults), "frames": entries}


def _frame_entry(name: str, frame: KitFrame) -> dict[str, Any]:
    camera = frame.camera
    numbers = ("fx", "fy", "cx", "cy", "width", "height", "near")
    return {
        "picture": name,
        "camera": {
            "view": camera.view.tolist(),
            **{field: getattr(camera, field) for field in numbers},
        },
        "values": {key: value.tolist() for key, value in frame.values.items()},
    }


def _cases_spoiled_by_fault(fault: str) -> dict[str, list[str]]:
    """Return the cases that a fault spoils, and those that it may spoil, if any."""
    names = [case.name for case in kit_cases() if fault in case.faults]
    slight = [case.name for case in kit_cases() if fault in case.slight]
    fault_cases = {"cases": [name for name in names if name not in slight]}
    return {**fault_cases, "slight": slight} if slight else fault_cases


def _index_document(cases: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "schema": check_viewer.INDEX_SCHEMA,
        "tool": {"name": "gsgen", "version": version("gsgen")},
        "tolerance": TOLERANCE,
        "tolerance_8_bits": TOLERANCE_8_BITS,
        "faults": [
            {"id": fault, "title": title, "hint": hint, **_cases_spoiled_by_fault(fault)}
            for fault, (title, hint) in VIEWER_FAULTS.items()
        ],
        "cases": cases,
    }
