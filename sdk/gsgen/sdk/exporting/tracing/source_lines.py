"""Finds the line of a user's code that raised an error or is running now."""

__all__ = ["current_user_line", "user_line_of"]

import linecache
import sys
import sysconfig
import traceback
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from types import FrameType

import gsgen.contract

_OWN_FOLDERS = (Path(__file__).parents[2], Path(gsgen.contract.__file__).parent)
_STDLIB_FOLDER = Path(sysconfig.get_path("stdlib"))
_SITE_FOLDERS = ("site-packages", "dist-packages")
# Packages that a user's line calls, so that their frames lie inside of its frame.
_LIBRARY_PACKAGES = frozenset(
    ("beartype", "jaxtyping", "numpy", "onnx", "onnx_ir", "onnxscript", "scipy", "torch")
)


def user_line_of(error: BaseException) -> str:
    """Return ``file:line (code)`` of the innermost frame of the user's code in a traceback.

    Frames of the SDK, of the standard library and of torch are skipped. Empty if all frames are.
    """
    if isinstance(error, SyntaxError) and error.filename and is_user_file(error.filename):
        return f"{Path(error.filename).name}:{error.lineno}"
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if is_user_file(frame.filename):
            return f"{Path(frame.filename).name}:{frame.lineno} ({frame.line})"
    return ""


def current_user_line(outer_frame: FrameType | None = None) -> str:
    """Return ``file:line (code)`` of the innermost running frame of the user's code.

    Frames from ``outer_frame`` on, which called the code in question, do not count.
    """
    for frame in _frames():
        if frame is outer_frame:
            break
        name = frame.f_code.co_filename
        if is_user_file(name):
            source_line = linecache.getline(name, frame.f_lineno).strip()
            return f"{Path(name).name}:{frame.f_lineno} ({source_line})"
    return ""


def _frames() -> Iterator[FrameType]:
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        yield frame
        frame = frame.f_back


@cache
def is_user_file(filename: str) -> bool:
    """Return whether a source file holds a user's code, not that of Python, torch or gsgen."""
    path = Path(filename)
    if not path.is_file() or any(path.is_relative_to(f) for f in _OWN_FOLDERS):
        return False
    package_indices = [path.parts.index(name) for name in _SITE_FOLDERS if name in path.parts]
    if package_indices:
        return path.parts[max(package_indices) + 1] not in _LIBRARY_PACKAGES
    return not path.is_relative_to(_STDLIB_FOLDER)
