"""The reactive client written again, from its description alone: JSON, CSV, and plain loops.

It shares no code with the product: boxes are culled corner by corner, the link is integrated by
small pieces of constant rate, and delays are kept one by one.
"""

import csv
import json
import math
from pathlib import Path


def read_tiles(path: Path) -> list[dict]:
    """Tiles in depth-first order, with boxes along the axes of the root frame."""
    tiles: list[dict] = []

    def visit(node: dict, parent: int, level: int) -> None:
        numbers = node["boundingVolume"]["box"]
        half = [math.hypot(*numbers[3 + 3 * i : 6 + 3 * i]) for i in range(3)]
        row = len(tiles)
        tiles.append(
            {
                "parent": parent,
                "level": level,
                "low": [c - h for c, h in zip(numbers[:3], half, strict=True)],
                "high": [c + h for c, h in zip(numbers[:3], half, strict=True)],
                "error": node["geometricError"],
                "size": node["metadata"]["properties"]["bytes"][0],
                "children": [],
            }
        )
        for child in node.get("children", []):
            tiles[row]["children"].append(len(tiles))
            visit(child, row, level + 1)

    visit(json.loads(path.read_text(encoding="utf-8"))["root"], -1, 0)
    return tiles


def read_csv(path: Path) -> list[list[float]]:
    with path.open(encoding="utf-8") as file:
        return [[float(value) for value in row] for row in list(csv.reader(file))[1:]]


def rotate_back(q: list[float], v: list[float]) -> list[float]:
    """The vector v of the root frame in the camera's frame: conj(q) v q."""
    w, x, y, z = q
    length = math.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / length, -x / length, -y / length, -z / length
    a, b, c = v
    tx, ty, tz = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return [
        a + w * tx + y * tz - z * ty,
        b + w * ty + z * tx - x * tz,
        c + w * tz + x * ty - y * tx,
    ]


def select_tiles(
    tiles: list[dict], row: list[float], view: dict
) -> tuple[list[int], set[int], dict]:
    """Seen tiles, wanted tiles and screen-space errors of a frame."""
    eye, quaternion = row[1:4], row[4:8]
    slope_y = math.tan(math.radians(view["fov"]) / 2)
    slope_x = slope_y * view["width"] / view["height"]
    actual, expected, errors = [], set(), {}
    pending = [0]
    while pending:
        index = pending.pop()
        tile = tiles[index]
        corners = []
        for choice in range(8):
            point = [
                (tile["high"] if choice >> axis & 1 else tile["low"])[axis] - eye[axis]
                for axis in range(3)
            ]
            corners.append(rotate_back(quaternion, point))
        outside = (
            all(z < 0 for _, _, z in corners)
            or all(x < -slope_x * z for x, _, z in corners)
            or all(x > slope_x * z for x, _, z in corners)
            or all(y < -slope_y * z for _, y, z in corners)
            or all(y > slope_y * z for _, y, z in corners)
        )
        if outside:
            continue
        axis_distances = [
            max(tile["low"][axis] - eye[axis], 0, eye[axis] - tile["high"][axis])
            for axis in range(3)
        ]
        distance = math.hypot(*axis_distances)
        if tile["error"] == 0:
            error = 0.0
        elif distance == 0:
            error = math.inf
        else:
            error = tile["error"] * view["height"] / (2 * distance * slope_y)
        actual.append(index)
        errors[index] = error
        if tile["children"] and error > view["sse"]:
            pending += tile["children"]
        else:
            expected.add(index)
    return actual, expected, errors


def finish_time(trace: list[list[float]], start: float, size: float) -> float:
    """When `size` bytes have arrived if the first one comes at `start`."""
    bits, now = size * 8, start
    while True:
        rate = trace[0][1] * 1e6
        end = math.inf
        for time, mbps in trace:
            if time <= now:
                rate = mbps * 1e6
            elif end == math.inf and time > now:
                end = time
        if rate > 0 and (end == math.inf or bits <= rate * (end - now)):
            return now + bits / rate
        if end == math.inf:
            return math.inf
        bits -= rate * (end - now)
        now = end


def reactive(tileset: Path, path: Path, network: Path, rtt: float, **view: float) -> dict:
    tiles, rows, trace = read_tiles(tileset), read_csv(path), read_csv(network)
    loaded, unseen = set(), set()
    link: tuple[float, int] | None = None
    entries: list[dict] = []
    before: set[int] = set()
    recorded: list[int] = []
    errors: dict[int, float] = {}
    received_count = requests = hole_count = good = 0
    first_good = None

    def ask(now: float) -> tuple[float, int] | None:
        nonlocal requests
        missing = [index for index in recorded if index not in loaded]
        if not missing:
            return None
        best = min(missing, key=lambda i: (tiles[i]["level"], -errors[i], i))
        requests += 1
        return finish_time(trace, now + rtt, tiles[best]["size"]), best

    for row in rows:
        while link is not None and link[0] <= row[0]:
            time, index = link
            loaded.add(index)
            unseen.add(index)
            received_count += tiles[index]["size"]
            for entry in entries:
                if entry["tile"] == index and entry["delay"] is None:
                    entry["delay"] = time - entry["time"]
            link = ask(time)
        recorded, expected, errors = select_tiles(tiles, row, view)
        unseen -= set(recorded)
        for index in sorted(expected - before):
            is_hit = index in loaded
            entries.append(
                {"tile": index, "time": row[0], "hit": is_hit, "delay": 0.0 if is_hit else None}
            )
        before = expected
        loaded_count = len(expected & loaded)
        if loaded_count >= 0.9 * len(expected):
            good += 1
            first_good = row[0] - rows[0][0] if first_good is None else first_good
        for index in expected:
            while index >= 0 and index not in loaded:
                index = tiles[index]["parent"]
            if index < 0:
                hole_count += 1
                break
        if link is None:
            link = ask(row[0])
    delays = sorted(
        rows[-1][0] - entry["time"] if entry["delay"] is None else entry["delay"]
        for entry in entries
    )
    position = 0.95 * (len(delays) - 1)
    low = math.floor(position)
    high = min(low + 1, len(delays) - 1)
    return {
        "hit_rate": sum(entry["hit"] for entry in entries) / len(entries),
        "waste": sum(tiles[index]["size"] for index in unseen) / received_count
        if received_count
        else 0.0,
        "first_good_s": first_good,
        "share_good": good / len(rows),
        "mean_delay_s": sum(delays) / len(delays),
        "p95_delay_s": delays[low] + (delays[high] - delays[low]) * (position - low),
        "hole_frames": hole_count,
        "entries": len(entries),
        "bytes": received_count,
        "requests": requests,
    }
