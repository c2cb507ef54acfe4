"""Reads the cameras of public recordings of people who look around in six degrees of freedom.

Nothing of them is copied: a bench takes a folder of checkouts. Each format is told by its path:

- ``interpolated/User*.csv`` of serhan-gul/dataset_6DoF: HoloLens users, 200 rows a second;
- ``dataset/sequence*.csv`` of Cedarleigh/ViewGauss-DataSet: viewers of splat video, 10 a second, with
  gaps in the number of the frame;
- ``sample_movement_data.csv`` of signetlabdei/questset: a headset game, with times.

All are of Unity: left-handed, y up, quaternions of the camera as x, y, z, w.
"""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.tiles.prediction.poses import Pose, matrix_quaternion

RATE = 10  # poses a second
_LEAST_POSES = 60
_FROM_UNITY = np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]])  # y up and z ahead to z up
_HEADSET_COLUMNS = (
    "time",
    *(f"HeadPos{axis}" for axis in "XYZ"),
    *(f"HeadOrientation{axis}" for axis in "XYZW"),
)


def recordings(folder: Path) -> dict[str, list[Pose]]:
    """Return the camera paths of all recordings below a folder, in right-handed axes, z up.

    Cameras have OpenCV axes, as those of `gsgen tiles simulate`.
    """
    paths = {}
    for name, rows in _tables(folder):
        if len(rows) >= _LEAST_POSES:
            paths[name] = [_pose(row) for row in rows]
    return paths


def _tables(folder: Path) -> Iterator[tuple[str, np.ndarray]]:
    """Yield name and rows t, x, y, z, qx, qy, qz, qw of each recording, 10 a second."""
    for file in sorted(folder.rglob("interpolated/User*.csv")):
        rows = _numbers(file, range(1, 8))[:: 200 // RATE]
        yield file.stem, _with_times(rows)
    for file in sorted(folder.rglob("dataset/sequence*.csv")):
        rows = _numbers(file, range(8))
        gaps = np.flatnonzero(np.diff(rows[:, 0]) != 1) + 1
        for number, part in enumerate(np.split(rows[:, 1:], gaps)):
            yield f"{file.stem}-{number}", _with_times(part)
    for file in sorted(folder.rglob("sample_movement_data.csv")):
        header = file.read_text().splitlines()[0].split(",")
        rows = _numbers(file, [header.index(name) for name in _HEADSET_COLUMNS])
        times = np.arange(rows[0, 0], rows[-1, 0], 1 / RATE)
        nearest = np.searchsorted(rows[:, 0], times).clip(0, len(rows) - 1)
        yield file.stem, np.column_stack([times - times[0], rows[nearest, 1:]])


def _with_times(rows: np.ndarray) -> np.ndarray:
    return np.column_stack([np.arange(len(rows)) / RATE, rows])


def _numbers(file: Path, columns: "list[int] | range") -> np.ndarray:
    """Return columns of a CSV file; rows that lack a number are left out."""
    rows = []
    with file.open(newline="") as stream:
        for fields in list(csv.reader(stream))[1:]:
            if len(fields) > max(columns) and all(fields[column] for column in columns):
                rows.append([float(fields[column]) for column in columns])
    return np.array(rows)


def _pose(row: np.ndarray) -> Pose:
    time, position, (x, y, z, w) = float(row[0]), row[1:4], row[4:]
    # A rotation keeps its matrix under a change of axes on both sides; Unity's camera looks along
    # z with y up, OpenCV's has y down: right, down and forward are the columns.
    quaternion = np.array([w, x, y, z]) / np.linalg.norm(row[4:])
    turn = _FROM_UNITY @ rotation_matrix(quaternion[None])[0]
    columns = turn @ np.diag([1.0, -1.0, 1.0])
    return Pose(time, _FROM_UNITY @ position, matrix_quaternion(columns))
