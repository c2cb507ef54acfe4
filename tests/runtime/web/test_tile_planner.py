"""The page requests tiles as Python does: the same orders, decisions and predicted cameras."""

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gsgen.contract.spec.geometry import rotation_matrix, rotation_quaternion
from gsgen.tiles.prediction.poses import Pose
from gsgen.tiles.prediction.predictor import ConstantVelocity
from gsgen.tiles.selection.request_order import finer_file_order
from gsgen.tiles.streaming.metrics import MetricsRecorder
from gsgen.tiles.streaming.planner import RequestPlanner
from support.tiles.request_trees import EYE, cut_of, ladder_of, tree_of
from support.web.packages import package
from support.web.pages import CLIENT

_SCRIPT = """
import { readFileSync } from "node:fs";
const { CameraPredictor, RequestPlanner, finerOrder } = await import(process.argv[1]);
const { rules, journeys, flights } = JSON.parse(readFileSync(process.argv[2]));
const decisions = journeys.map(({ tiles, connections, frames }) => {
  for (const tile of tiles) tile.quality = -1;
  const log = [];
  const flying = new Map();
  const planner = new RequestPlanner({ ...rules, requests: connections }, (tile, flight) => {
    log.push([tile.index, flight.purpose]);
    flying.set(tile, flight);
    flight.stop.signal.addEventListener("abort", () => {
      log.push([tile.index, "cancelled"]);
      flying.delete(tile);
    });
  });
  const isLoaded = (tile) => tile.quality >= 0;
  for (const { time, seen, candidates, isKnown, progress, arrivals, evicted } of frames) {
    for (const index of arrivals) {
      const tile = tiles[index];
      tile.quality = tile.quality < 0 ? 1 : 0;
      flying.delete(tile);
      planner.arrive(tile, time, tile.files[tile.quality].bytes);
    }
    for (const index of evicted) tiles[index].quality = -1;
    for (const [{ index, files, quality }, flight] of flying) {
      flight.loaded = progress[index] * files[quality < 0 ? 1 : 0].bytes;
    }
    const errors = new Map(seen.map(([index, error]) => [tiles[index], error ?? Infinity]));
    planner.frame(time, errors, isLoaded);
    const drawn = [...errors.keys()].filter(isLoaded);
    planner.fill(isLoaded, finerOrder(drawn, [0, 0, 0]), candidates.map((index) => tiles[index]), isKnown);
    log.push(planner.received);
  }
  return log;
});
const cameras = flights.map(({ poses, ahead }) => {
  const predictor = new CameraPredictor(rules);
  for (const { time, view } of poses) predictor.observe(time, { view });
  return ahead.map((seconds) => predictor.predict(seconds));
});
console.log(JSON.stringify({ decisions, cameras }));
"""


def decisions_of_client(folder: Path, journeys: list[Any], flights: list[Any]) -> Any:
    package("types-0.1.74", needs_node=True)  # Node.js is there where other packages are
    rules = json.loads((CLIENT / "plans.json").read_text("utf-8"))["streaming"]
    document = folder / "vectors.json"
    document.write_text(json.dumps({"rules": rules, "journeys": journeys, "flights": flights}))
    module = (CLIENT / "tile_planner.js").as_uri()
    command = ["node", "--input-type=module", "--eval", _SCRIPT, module, document]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.stderr == ""
    return json.loads(result.stdout)


class ScriptedLink:
    """A link whose requests come as far as a script says, and which notes what it is asked."""

    def __init__(self, connections: int, size: np.ndarray, log: list[Any]) -> None:
        self.connections, self.size, self.log = connections, size, log
        self.flying: dict[int, float] = {}
        self.planner: Any = None

    @property
    def free_request_count(self) -> int:
        return self.connections - len(self.flying)

    def request(self, tile: int) -> None:
        self.flying[tile] = 0.0
        self.log.append([tile, self.planner._purpose_by_pending_tile[tile]])

    def progress(self, tile: int) -> float:
        return self.flying[tile]

    def cancel(self, tile: int) -> int:
        self.log.append([tile, "cancelled"])
        return float(self.size[tile]) * self.flying.pop(tile)  # type: ignore[return-value]


class ScriptedPrefetch:
    """Says what a script expects to be seen."""

    order: list[int]

    def observe(self, pose: Pose) -> None:
        pass

    def candidates(self, loaded: np.ndarray) -> list[int]:
        return [tile for tile in self.order if not loaded[tile]]


def journey(seed: int) -> tuple[dict[str, Any], list[Any]]:
    """A random journey through a random tree of two qualities, and Python's decisions in it."""
    rng = np.random.default_rng(seed)
    count = 24
    parents = [-1, *(int(rng.integers(row)) for row in range(1, count))]
    places = rng.uniform(2, 40, count).tolist()
    tree = tree_of(parents, places)
    sizes = np.sort(rng.integers(50, 400, (count, 2)), axis=1)[:, ::-1]
    worth = np.sort(rng.uniform(0.9, 1, (count, 2)), axis=1)[:, ::-1]
    ladder = ladder_of(sizes, worth)
    tree.size[:] = sizes[:, 1]
    connections = int(rng.integers(1, 5))
    log: list[Any] = []
    link = ScriptedLink(connections, tree.size.copy(), log)
    recorder, prefetch = MetricsRecorder(tree.parent, tree.size), ScriptedPrefetch()
    planner = link.planner = RequestPlanner(tree, link, recorder, prefetch)
    planner._is_bounded = seed % 4 > 0  # as along paths that are known
    held = np.full(count, -1)
    frames = []
    for time in np.cumsum(rng.choice([0.05, 1.0], 40)).tolist():
        seen = rng.uniform(size=count) < rng.choice([0.3, 0.9])
        seen[0] = True
        for row in range(1, count):
            seen[row] &= seen[tree.parent[row]]
        error = np.where(rng.uniform(size=count) < 0.2, np.inf, rng.integers(0, 6, count))
        prefetch.order = rng.permutation(count)[:8].tolist()
        arrivals = [tile for tile in list(link.flying) if rng.uniform() < 0.5]
        for tile in arrivals:
            del link.flying[tile]
            held[tile] = 1 if held[tile] < 0 else 0
            tree.size[tile] = sizes[tile, held[tile]]
            planner.arrive(tile, time)
        unseen = np.flatnonzero((held >= 0) & ~seen & ~np.isin(np.arange(count), list(link.flying)))
        evicted = [int(tile) for tile in unseen if rng.uniform() < 0.1]
        for tile in evicted:
            held[tile], tree.size[tile] = -1, sizes[tile, 1]
        progress = rng.uniform(size=count).round(3)
        for tile in link.flying:
            link.flying[tile] = float(progress[tile])
            link.size[tile] = sizes[tile, 1 if held[tile] < 0 else 0]
        frames.append(
            {
                "time": time,
                "seen": [
                    [int(row), float(error[row]) if np.isfinite(error[row]) else None]
                    for row in np.flatnonzero(seen)
                ],
                "candidates": prefetch.order,
                "isKnown": not planner._is_bounded,
                "progress": progress.tolist(),
                "arrivals": arrivals,
                "evicted": evicted,
            }
        )
        cut, loaded = cut_of(seen.tolist(), error.tolist()), held >= 0
        recorder.frame(time, cut, loaded)
        planner.frame(Pose(time, EYE, np.array([1.0, 0, 0, 0])), cut, loaded)
        finer = finer_file_order(tree, ladder, held, seen & loaded, EYE)
        planner.fill(loaded, finer.tolist())
        log.append(recorder.bytes)
    tiles = [
        {
            "index": row,
            "level": int(tree.level[row]),
            "bytes": int(sizes[row, 1]),
            "files": [
                {"bytes": int(size), "worth": float(value)}
                for size, value in zip(sizes[row], worth[row], strict=True)
            ],
            "center": tree.center[row].tolist(),
            "axes": tree.half_axes[row].tolist(),
        }
        for row in range(count)
    ]
    return {"tiles": tiles, "connections": connections, "frames": frames}, log


def flight(seed: int) -> tuple[dict[str, Any], list[Any]]:
    """A random path of cameras, and Python's predictions after it."""
    rng = np.random.default_rng(seed)
    predictor, poses = ConstantVelocity(), []
    start, velocity, rate = rng.normal(size=(3, 3))
    rate *= [0.0, 1e-7, 1.0, 3.0][seed % 4]
    for time in np.cumsum(rng.uniform(0.01, 0.2, 1 + seed % 12)).tolist():
        turn = rotation_quaternion(rate * time + [0.3, 0.1, 0.2])
        position = start + velocity * time
        predictor.observe(Pose(time, position, turn))
        poses.append({"time": time, "view": view_of(turn, position)})
    ahead = [0.25, 0.5, 1.0, 2.0]
    predictions = [view_of(pose.quaternion, pose.position) for pose in predictor.predict(ahead)]
    return {"poses": poses, "ahead": ahead}, predictions or [None] * len(ahead)


def view_of(quaternion: np.ndarray, position: np.ndarray) -> list[float]:
    rotation = rotation_matrix(quaternion[None])[0].T
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ position
    return [float(number) for number in matrix.ravel()]


def test_the_page_decides_as_python_does(tmp_path: Path) -> None:
    journeys = [journey(seed) for seed in range(60)]
    flights = [flight(seed) for seed in range(40)]
    actual = decisions_of_client(
        tmp_path, [vectors for vectors, _ in journeys], [vectors for vectors, _ in flights]
    )
    purposes = {entry[1] for _, log in journeys for entry in log if isinstance(entry, list)}
    assert purposes == {"needed", "prefetched", "finer", "cancelled"}
    for log, (_, expected) in zip(actual["decisions"], journeys, strict=True):
        sums = [entry for entry in expected if not isinstance(entry, list)]
        assert [entry for entry in log if not isinstance(entry, list)] == pytest.approx(sums)
        assert [entry for entry in log if isinstance(entry, list)] == [
            entry for entry in expected if isinstance(entry, list)
        ]
    for views, (_, predictions) in zip(actual["cameras"], flights, strict=True):
        for view, prediction in zip(views, predictions, strict=True):
            assert (view is None) == (prediction is None)
            if view is not None:
                assert view == pytest.approx(prediction, abs=1e-9)
