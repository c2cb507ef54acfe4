"""A town of tiles without files, camera paths through it, and networks, for simulations."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

Row = tuple[float, ...]


def town_document(*, seed: int = 0, depth: int = 4, side: float = 200.0, size: float = 60e3):
    """The JSON of a tileset: a flat octree with boxes, errors and sizes, and no files."""
    rng = np.random.default_rng(seed)

    def tile(center: np.ndarray, width: float, level: int) -> dict:
        children = []
        if level < depth:
            for offset in np.ndindex(2, 2, 2):
                middle = center + (np.array(offset) - 0.5) * width / 2
                above = middle[2] - width / 4
                if above > 12 or middle[2] + width / 4 < 0:
                    continue
                if level >= 3 and above > 2 and rng.uniform() < 0.4:
                    continue
                children.append(tile(middle, width / 2, level + 1))
        half = np.diag([width / 2] * 3).ravel()
        name = f"t/{level}/{rng.integers(1 << 30)}.glb"
        bytes_of_tile = int(rng.lognormal(np.log(size), 0.4))
        properties = {"bytes": [bytes_of_tile], "splats": bytes_of_tile // 14, "cell": 1.0}
        document = {
            "boundingVolume": {"box": [*center.tolist(), *half.tolist()]},
            "geometricError": width / 40 if children else 0.0,
            "content": {"uri": name},
            "metadata": {"class": "gsgen_tile", "properties": properties},
        }
        return document | ({"children": children} if children else {})

    return {
        "asset": {"version": "1.1"},
        "geometricError": side,
        "metadata": {"class": "gsgen_tileset", "properties": {"quality": 0, "sh_degree": 0}},
        "root": tile(np.zeros(3), side, 0) | {"refine": "REPLACE"},
    }


def pose_row(time: float, eye: np.ndarray, target: np.ndarray) -> Row:
    """A row of a path: a camera at ``eye`` that looks at ``target``; z is up."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    matrix = np.stack([right, np.cross(forward, right), forward], axis=1)
    # The quaternion is the eigenvector of the largest eigenvalue (Bar-Itzhack 2000).
    (a, b, c), (d, e, f), (g, h, i) = matrix
    symmetric = [
        [a - e - i, b + d, c + g, h - f],
        [b + d, e - a - i, f + h, c - g],
        [c + g, f + h, i - a - e, d - b],
        [h - f, c - g, d - b, a + e + i],
    ]
    x, y, z, w = np.linalg.eigh(np.array(symmetric) / 3)[1][:, -1]
    return (time, *eye, w, x, y, z)


def _follow(
    eye: Callable[[float], np.ndarray],
    target: Callable[[float], np.ndarray],
    seconds: float,
    rate: float,
) -> list[Row]:
    times = np.arange(0, seconds, 1 / rate)
    return [pose_row(float(t), eye(t), target(t)) for t in times]


def journeys(seconds: float = 30.0, rate: float = 10.0) -> dict[str, list[Row]]:
    """Camera paths by name: four smooth ones, one that wanders."""

    def ring(radius: float, speed: float, height: float):
        return lambda t: np.array([radius * np.cos(speed * t), radius * np.sin(speed * t), height])

    def street(t: float) -> np.ndarray:
        return np.array([-90 + 4 * t, 3 * np.sin(t / 5), 4.0])

    def flight(t: float) -> np.ndarray:
        return np.array([-90 + 4.5 * t, -60 + 3 * t, 30 - 0.4 * t])

    paths_by_name = {
        "orbit": (ring(70, 1 / 12, 25), lambda t: np.zeros(3)),
        "street": (street, lambda t: street(t + 3)),
        "flight": (flight, lambda t: flight(t) + np.array([20, 13, -25 + 0.4 * t])),
        "turning": (lambda t: np.array([0, 0, 8.0]), ring(10, 0.3, 6)),
    }
    paths = {name: _follow(*pair, seconds, rate) for name, pair in paths_by_name.items()}
    rng = np.random.default_rng(5)
    position, yaw, turn = np.array([-60.0, -40, 5]), 0.0, 0.0
    wander_poses = []
    for t in np.arange(0, seconds, 1 / rate):
        turn += -2 * turn / rate + rng.normal() * 1.5 / np.sqrt(rate)
        yaw += turn / rate
        ahead = np.array([np.cos(yaw), np.sin(yaw), 0])
        position = np.clip(position + ahead * 4 / rate, -95, 95)
        wander_poses.append(pose_row(float(t), position, position + ahead - [0, 0, 0.1]))
    return paths | {"wander": wander_poses}


def networks() -> dict[str, list[Row]]:
    """Traces by name: constant rates in megabits a second, and one like a phone's."""
    rates = np.random.default_rng(3).uniform(5, 60, 40)
    mobile = [(float(t), float(rate)) for t, rate in enumerate(rates)]
    return {"20": [(0.0, 20.0)], "50": [(0.0, 50.0)], "mobile": mobile}


def write_rows(path: Path, header: str, rows: list[Row]) -> Path:
    """Write a table as CSV, with all digits."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header.split(","))
        writer.writerows([[repr(float(value)) for value in row] for row in rows])
    return path


def write_town(folder: Path, **options: object) -> Path:
    """Write the index of a town; its contents do not exist."""
    path = folder / "tileset.json"
    path.write_text(json.dumps(town_document(**options)))
    return path


PATH_HEADER = "t,x,y,z,qw,qx,qy,qz"
TRACE_HEADER = "t,mbps"
