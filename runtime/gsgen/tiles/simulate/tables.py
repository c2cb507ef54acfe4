"""Read camera paths and network traces from CSV files."""

__all__ = ["read_path", "read_trace"]

import csv
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float64

from gsgen.contract.errors import InputUnreadable
from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.simulate.network import RateTrace

PATH_COLUMNS: Final = ("t", "x", "y", "z", "qw", "qx", "qy", "qz")
TRACE_COLUMNS: Final = ("t", "mbps")
_MAX_FILE_BYTES: Final = 256 << 20
_MEGABITS_PER_BYTE: Final = 8e-6  # megabits of a byte
_MIN_VECTOR_LENGTH: Final = 1e-9


def read_path(path: Path) -> list[Pose]:
    """Read a camera path: CSV ``t,x,y,z,qw,qx,qy,qz``, camera → tileset, OpenCV axes.

    Raises:
        InputUnreadable: The file is missing or not such a table; the error names the line.
    """
    rows = _read_table(path, PATH_COLUMNS)
    lengths = np.linalg.norm(rows[:, 4:], axis=1)
    if (short_vectors := np.flatnonzero(lengths < _MIN_VECTOR_LENGTH)).size:
        line = int(short_vectors[0])
        raise _table_error(
            path, line + 2, f"quaternion {rows[line, 4:].tolist()}", "a length above 0"
        )
    quaternions = rows[:, 4:] / lengths[:, None]
    return [
        Pose(float(row[0]), row[1:4].copy(), quaternion)
        for row, quaternion in zip(rows, quaternions, strict=True)
    ]


def read_trace(path: Path) -> RateTrace:
    """Read a network trace: CSV ``t,mbps``, megabits a second from each time on.

    Raises:
        InputUnreadable: The file is missing or not such a table; the error names the line.
    """
    rows = _read_table(path, TRACE_COLUMNS)
    if (negative_rows := np.flatnonzero(rows[:, 1] < 0)).size:
        line = int(negative_rows[0])
        raise _table_error(path, line + 2, f"{rows[line, 1]:g} Mbps", "0 or more")
    return RateTrace(rows[:, 0], rows[:, 1] / _MEGABITS_PER_BYTE)


def _read_table(path: Path, columns: tuple[str, ...]) -> Float64[np.ndarray, "n c"]:
    """Read named columns of a CSV file as numbers; the first column, time, must ascend."""
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise InputUnreadable(
                f"the file has {path.stat().st_size:,} bytes, expected {_MAX_FILE_BYTES:,} or fewer",
                where=str(path),
                hint="Split the table.",
            )
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputUnreadable(
            f"cannot be read: {reason}",
            where=str(path),
            hint=f"Name a CSV file with the columns {','.join(columns)}.",
        ) from error
    lines = csv.reader(text.splitlines())
    header = [name.strip() for name in next(lines, [])]
    missing = [name for name in columns if name not in header]
    if missing:
        raise _table_error(path, 1, f"columns {','.join(header)!r:.60}", ",".join(columns))
    column_indices = [header.index(name) for name in columns]
    rows: list[list[float]] = []
    for fields in lines:
        if not fields:
            continue
        rows.append(_read_row(path, lines.line_num, fields, column_indices, len(header)))
        if len(rows) > 1 and rows[-1][0] <= rows[-2][0]:
            expected = f"a time after {rows[-2][0]:g}"
            raise _table_error(path, lines.line_num, f"t {rows[-1][0]:g}", expected)
    if not rows:
        raise _table_error(path, 2, "the table has no rows", "at least one row")
    return np.array(rows, np.float64)


def _read_row(
    path: Path, line: int, fields: list[str], column_indices: list[int], width: int
) -> list[float]:
    if len(fields) != width:
        raise _table_error(path, line, f"{len(fields)} fields", f"{width}, as in the first line")
    try:
        row = [float(fields[pick]) for pick in column_indices]
    except ValueError:
        row = [np.nan]
    if not np.isfinite(row).all():
        raise _table_error(path, line, f"{','.join(fields)!r:.60}", "finite numbers")
    return row


def _table_error(path: Path, line: int, actual: str, expected: str) -> InputUnreadable:
    return InputUnreadable(f"{actual}, expected {expected}", where=f"{path}, line {line}")
