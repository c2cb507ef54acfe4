"""Find the line of the user's code that something happened in."""

__all__ = ["line_here", "line_of"]

import linecache
import sys
import sysconfig
import traceback
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import FrameType

_OURS = Path(__file__).parents[1]
_STANDARD = Path(sysconfig.get_path("stdlib"))
_PACKAGES = ("site-packages", "dist-packages")
# Packages whose frames stand between a user's line and what happened in it.
_BETWEEN = frozenset(
    ("beartype", "jaxtyping", "numpy", "onnx", "onnx_ir", "onnxscript", "scipy", "torch")
)


def line_of(error: BaseException) -> str:
    """Return ``file:line (code)`` of the innermost frame of the user's that ``error`` left.

    A frame is the user's if it is neither ours nor the standard library's nor torch's; empty where
    there is none.
    """
    if isinstance(error, SyntaxError) and error.filename and is_users(error.filename):
        return f"{Path(error.filename).name}:{error.lineno}"
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if is_users(frame.filename):
            return f"{Path(frame.filename).name}:{frame.lineno} ({frame.line})"
    return ""


def line_here() -> str:
    """Return ``file:line (code)`` of the innermost frame of the user's that runs now."""
    for frame in _frames():
        name = frame.f_code.co_filename
        if is_users(name):
            code = linecache.getline(name, frame.f_lineno).strip()
            return f"{Path(name).name}:{frame.f_lineno} ({code})"
    return ""


def _frames() -> Iterator[FrameType]:
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        yield frame
        frame = frame.f_back


@cache
def is_users(filename: str) -> bool:
    """Say whether a source file is the user's."""
    path = Path(filename)
    if not path.is_file() or path.is_relative_to(_OURS):
        return False
    found = [path.parts.index(name) for name in _PACKAGES if name in path.parts]
    if found:
        return path.parts[max(found) + 1] not in _BETWEEN
    return not path.is_relative_to(_STANDARD)
