"""Simulations: the reactive client is that of an independent program; prefetching is no worse."""

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.runtime.scene.camera import Camera
from gsgen.tiles.loading.quality_ladder import QualityLadder
from gsgen.tiles.loading.tileset_loader import open_tileset
from gsgen.tiles.prediction.poses import Pose, matrix_quaternion
from gsgen.tiles.prediction.predictor import ConstantVelocity
from gsgen.tiles.prediction.prefetch import ViewSettings
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.simulate.client import Policy, Simulation, simulate
from gsgen.tiles.simulate.network import RateTrace, SimulatedLink, VirtualClock
from gsgen.tiles.simulate.prediction_error import prediction_error
from gsgen.tiles.simulate.report import metrics_document
from gsgen.tiles.simulate.tables import read_path, read_trace
from gsgen.tiles.validation.sketches import explicit_sketch
from support.commands import gsgen_here
from support.tiles.journeys import (
    PATH_HEADER,
    TRACE_HEADER,
    journeys,
    networks,
    write_rows,
    write_town,
)
from tiles.simulate.reactive_oracle import reactive

JOURNEYS = journeys()
NETWORKS = networks()
SMALL_VIEW = ViewSettings(width=320, height=180)
SMOOTH = ("orbit", "street", "flight", "turning")


@pytest.mark.parametrize(
    ("journey", "network", "rtt", "view"),
    [
        ("orbit", "20", 50, {}),
        ("street", "mobile", 120, {"sse": 24, "fov": 70, "width": 640, "height": 480}),
        ("wander", "50", 0, {"sse": 40}),
        ("turning", "mobile", 30, {"sse": 20, "width": 300, "height": 600}),
    ],
)
def test_the_reactive_client_is_that_of_its_description(
    tmp_path: Path, journey: str, network: str, rtt: float, view: dict
) -> None:
    tileset = write_town(tmp_path, depth=3, seed=1)
    rows = JOURNEYS[journey][:160]
    path = write_rows(tmp_path / "path.csv", PATH_HEADER, rows)
    trace = write_rows(tmp_path / "trace.csv", TRACE_HEADER, NETWORKS[network])
    options = [part for name, value in view.items() for part in (f"--{name}", value)]
    result = gsgen_here(
        "tiles", "simulate", tileset, "--path", path, "--network", trace,
        "--policy", "reactive", "--rtt", rtt, *options, "--json",
    )  # fmt: skip
    assert result.code == 0, result.err
    metrics = json.loads(result.out)
    defaults = {"width": 1280, "height": 720, "fov": 50.0, "sse": 16.0}
    expected = reactive(tileset, path, trace, rtt / 1000, **(defaults | view))
    assert expected["entries"] > 30
    assert expected["hit_rate"] < 1
    for name, value in expected.items():
        assert metrics[name] == pytest.approx(value, rel=0.02, abs=1e-9), name


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> TileTree:
    return TileTree.of_tileset(open_tileset(write_town(tmp_path_factory.mktemp("town"))))


def run(
    tmp_path: Path, tree: TileTree, journey: str, network: str, policy: str, rows: int | None = None
) -> Simulation:
    path = write_rows(tmp_path / "path.csv", PATH_HEADER, JOURNEYS[journey][:rows])
    trace = write_rows(tmp_path / "trace.csv", TRACE_HEADER, NETWORKS[network])
    return simulate(tree, read_path(path), read_trace(trace), policy=policy, view=SMALL_VIEW)


@pytest.mark.parametrize("network", ["20", "mobile"])
@pytest.mark.parametrize("journey", list(JOURNEYS))
def test_prefetching_raises_hits_and_delays_nothing(
    tmp_path: Path, tree: TileTree, journey: str, network: str
) -> None:
    reactive_metrics = run(tmp_path, tree, journey, network, "reactive").metrics
    predicting = run(tmp_path, tree, journey, network, "predictive").metrics
    assert reactive_metrics.entries == predicting.entries > 50
    assert predicting.hit_rate > reactive_metrics.hit_rate
    assert predicting.p95_delay_s <= reactive_metrics.p95_delay_s
    assert predicting.hole_frames <= reactive_metrics.hole_frames
    assert predicting.waste <= 0.15
    if journey in SMOOTH:
        oracle_metrics = run(tmp_path, tree, journey, network, "oracle").metrics
        assert predicting.hit_rate >= 0.9 * oracle_metrics.hit_rate
        assert oracle_metrics.waste <= 0.15


class RandomPredictor:
    """Predicts poses anywhere in the town, so that most prefetched tiles stay unseen."""

    name, reach = "random", 10.0

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)

    def observe(self, pose: Pose) -> None:
        self._last = pose

    def predict(self, ahead: Sequence[float]) -> list[Pose]:
        places = self._rng.uniform((-80, -80, 0), (80, 80, 8), (len(ahead), 3))
        turns = self._rng.normal(size=(len(ahead), 4))
        turns /= np.linalg.norm(turns, axis=1, keepdims=True)
        times = [self._last.time + seconds for seconds in ahead]
        return [Pose(*pose) for pose in zip(times, places, turns, strict=True)]


def test_random_predictor_wastes_less_than_a_quarter_and_delays_nothing(
    tmp_path: Path, tree: TileTree
) -> None:
    reactive_metrics = run(tmp_path, tree, "wander", "mobile", "reactive").metrics
    path, trace = read_path(tmp_path / "path.csv"), read_trace(tmp_path / "trace.csv")
    result = simulate(
        tree, path, trace, policy="predictive", predictor=RandomPredictor, view=SMALL_VIEW
    ).metrics
    assert 0.02 < result.waste <= 0.25
    assert result.requests > reactive_metrics.requests
    assert result.p95_delay_s <= reactive_metrics.p95_delay_s


def test_equal_simulations_are_equal_bit_for_bit(tmp_path: Path, tree: TileTree) -> None:
    for policy in ("reactive", "predictive", "oracle"):
        first = run(tmp_path, tree, "wander", "mobile", policy, rows=300)
        assert first.metrics.entries > 30
        assert first == run(tmp_path, tree, "wander", "mobile", policy, rows=300)


@pytest.mark.parametrize("connections", [1, 3])
def test_a_link_delivers_what_the_rate_allows(connections: int) -> None:
    """The bytes of all deliveries, compared with the integral of the rate in small steps."""
    rng = np.random.default_rng(connections)
    times = np.cumsum(rng.uniform(0.1, 1, 20))
    rates = rng.uniform(0, 1e5, 20)
    rates[5], rates[-1] = 0, 8e4
    size = rng.integers(1, 30_000, 60)
    clock = VirtualClock(0.3)
    link = SimulatedLink(clock, RateTrace(times, rates), size, rtt=0.05, connections=connections)
    pending, starts, ends = list(range(60)), {}, {}
    while pending or link.free_request_count < connections:
        while pending and link.free_request_count:
            starts[pending[0]] = clock.now()
            link.request(pending.pop(0))
        delivered = link.advance(math.inf)
        assert delivered is not None
        ends[delivered.tile] = delivered.time
    # Small steps: every transfer that has begun has an equal share.
    step, now, left = 1e-3, 0.3, dict(enumerate(size.astype(float)))
    while left and now < 60:
        active = [t for t in left if starts[t] + 0.05 <= now]
        index = max(int(np.searchsorted(times, now, side="right")) - 1, 0)
        for tile in active:
            left[tile] -= rates[index] * step / len(active)
            if left[tile] <= 0:
                assert now == pytest.approx(ends[tile], abs=0.1)
                del left[tile]
        now += step
    assert not left


def test_a_cancelled_request_has_the_bytes_that_came() -> None:
    clock = VirtualClock(0.0)
    trace = RateTrace(np.array([0.0]), np.array([1000.0]))
    link = SimulatedLink(clock, trace, np.array([5000, 1000]), rtt=0.5, connections=1)
    link.request(0)
    assert link.advance(2.5) is None
    assert link.progress(0) == pytest.approx(0.4)
    assert link.cancel(0) == 2000
    assert link.free_request_count == 1
    link.request(1)
    delivered = link.advance(9.0)
    assert delivered is not None
    assert (delivered.tile, delivered.time) == (1, pytest.approx(4.0))


def test_the_table_and_the_plot_compare_all_policies(tmp_path: Path) -> None:
    from PIL import Image

    tileset = write_town(tmp_path, depth=2)
    path = write_rows(tmp_path / "path.csv", PATH_HEADER, JOURNEYS["orbit"][:60])
    trace = write_rows(tmp_path / "trace.csv", TRACE_HEADER, NETWORKS["20"])
    options = ["--path", path, "--network", trace, "--policy", "all"]
    plot = tmp_path / "plot.png"
    result = gsgen_here("tiles", "simulate", tileset, *options, "--plot", plot)
    assert result.code == 0, result.err
    for word in ("reactive", "predictive", "oracle", "hit rate", "waste", "received"):
        assert word in result.out
    with Image.open(plot) as picture:
        assert np.asarray(picture.convert("L")).std() > 5
    first = plot.read_bytes()
    gsgen_here("tiles", "simulate", tileset, *options, "--plot", plot)
    assert plot.read_bytes() == first
    listed = json.loads(gsgen_here("tiles", "simulate", tileset, *options, "--json").out)
    assert [entry["policy"] for entry in listed] == ["reactive", "predictive", "oracle"]
    result = gsgen_here("tiles", "simulate", tileset, *options, "--plot", tmp_path / "plot.xyz")
    assert result.code == 2
    assert "plot.xyz" in result.err


def test_pictures_on_the_way_are_scored(tmp_path: Path) -> None:
    """Nothing is drawn at first, on black; in the end what all tiles at their finest files show."""
    tileset = explicit_sketch(qualities=(0, 2, 4))
    tileset.write(tmp_path / "tileset.json")
    camera = Camera.look_at([5, -14, 5], [5, 0, 0], up=(0, 0, 1), width=64, height=48)
    quaternion = matrix_quaternion(camera.view[:3, :3].T)
    poses = [[time, *camera.eye, *quaternion] for time in np.arange(3, 8.5, 0.5)]
    path = write_rows(tmp_path / "path.csv", PATH_HEADER, poses)
    trace = write_rows(tmp_path / "trace.csv", TRACE_HEADER, [(0.0, 0.05)])
    options = ["--path", path, "--network", trace, "--width", "64", "--height", "48", "--sse", "1"]
    command = ["tiles", "simulate", tmp_path, *options, "--policy", "all"]
    result = gsgen_here(*command, "--score", "5,0,1.2", "--json")
    assert result.code == 0, result.err
    for simulation in json.loads(result.out):
        scores = {entry["t"]: entry["ssim"] for entry in simulation["ssim"]}
        assert list(scores) == [0, 1.2, 5]
        assert scores[0] < scores[1.2] < scores[5] == pytest.approx(1)
    assert "SSIM at 1.2 s" in gsgen_here(*command, "--score", "1.2").out
    for score, message in (("1,x", "seconds such as 1,2,5"), ("9", "from 0 to 5")):
        result = gsgen_here(*command, "--score", score)
        assert result.code == 2
        assert "--score" in result.err
        assert message in result.err


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("a,b\n1,2\n", "line 1: columns 'a,b', expected t,x,y,z"),
        ("t,x,y,z,qw,qx,qy,qz\n", "the table has no rows"),
        ("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0\n", "line 2: 7 fields"),
        ("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,nan\n", "line 2: '0,0,0,0,1,0,0,nan'"),
        ("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n0,0,0,0,1,0,0,0\n", "line 3: t 0"),
        ("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,0,0,0,0\n", "line 2: quaternion"),
    ],
)
def test_a_wrong_path_is_named_with_its_line(tmp_path: Path, rows: str, message: str) -> None:
    tileset = write_town(tmp_path, depth=1)
    trace = write_rows(tmp_path / "trace.csv", TRACE_HEADER, NETWORKS["20"])
    path = tmp_path / "path.csv"
    path.write_text(rows)
    result = gsgen_here("tiles", "simulate", tileset, "--path", path, "--network", trace)
    assert result.code == 4
    assert message in result.err
    path.write_text("t,x,y,z,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n")
    trace.write_text("t,mbps\n0,-1\n")
    result = gsgen_here("tiles", "simulate", tileset, "--path", path, "--network", trace)
    assert result.code == 4
    assert "-1 Mbps" in result.err
    result = gsgen_here(
        "tiles", "simulate", tileset, "--path", path, "--network", tmp_path / "none"
    )
    assert result.code == 4
    options = ["--path", path, "--network", trace, "--predictor", "constant_velocity"]
    result = gsgen_here("tiles", "simulate", tileset, *options)
    assert result.code == 2
    assert "constant-velocity" in result.err


@pytest.mark.parametrize("policy", ["reactive", "predictive"])
def test_qualities_give_whole_pictures_sooner(
    tmp_path: Path, tree: TileTree, policy: Policy
) -> None:
    """Each tile comes at its coarsest file, and its finest follows: to a camera that stands."""
    sizes = tree.size[:, None] * np.array([1.0, 0.7, 0.5])
    worth = np.tile([1.0, 0.98, 0.95], (len(tree), 1))
    ladder = QualityLadder(files=(), size=sizes.round(), worth=worth)
    [pose] = read_path(write_rows(tmp_path / "path.csv", PATH_HEADER, JOURNEYS["street"][:1]))
    path = [replace(pose, time=0.1 * frame) for frame in range(300)]
    trace = RateTrace(np.array([0.0]), np.array([250_000.0]))
    plain, layered = (
        simulate(tree, path, trace, ladder=entry, policy=policy, view=SMALL_VIEW)
        for entry in (None, ladder)
    )
    assert plain.share_loaded[-1] == layered.share_loaded[-1] == 1
    assert layered.metrics.first_good_s < plain.metrics.first_good_s
    assert layered.metrics.mean_delay_s < 0.8 * plain.metrics.mean_delay_s
    # The drawn tiles come twice, those above them once, at half of their bytes.
    assert 0.5 * plain.metrics.bytes < layered.metrics.bytes < 1.5 * plain.metrics.bytes
    assert layered.metrics.requests > plain.metrics.requests


def test_prediction_errors_are_those_of_the_motion(tree: TileTree) -> None:
    """Steady motion is predicted exactly; a camera that gains speed is farther each moment."""
    identity = np.array([1.0, 0, 0, 0])
    times = np.arange(0, 8, 0.125)
    steady = [Pose(time, np.array([3 * time, 1.0, 2.0]), identity) for time in times.tolist()]
    actual = prediction_error(tree, steady, ConstantVelocity(), SMALL_VIEW)
    assert (actual.ade, actual.fde, actual.turn) == pytest.approx((0, 0, 0), abs=1e-9)
    assert actual.coverage == 1
    gaining = [replace(pose, position=np.array([pose.time**2, 0, 2])) for pose in steady]
    actual = prediction_error(tree, gaining, ConstantVelocity(), SMALL_VIEW)
    # x = t², of which the predictor sees the speed 2 t − w over the window w: half a second at first,
    # then a frame more, eleven moments in all.
    windows = np.array([0.5, *[0.625] * 10])[:, None]
    ahead = np.array([0.25, 0.5, 1.0, 2.0])
    errors = ahead**2 + windows * ahead
    assert actual.ade == pytest.approx(errors.mean())
    assert actual.fde == pytest.approx(errors[:, -1].mean())
    assert 0 <= actual.coverage <= 1
    still = prediction_error(tree, steady[:1], ConstantVelocity(), SMALL_VIEW)
    assert np.isnan(still.ade)


def test_simulate_reports_prediction_beside_hits(tmp_path: Path, tree: TileTree) -> None:
    documents = {
        policy: metrics_document(run(tmp_path, tree, "orbit", "20", policy, 40))
        for policy in ("reactive", "predictive")
    }
    assert "prediction" not in documents["reactive"]
    assert documents["predictive"]["prediction"].keys() == {"ade", "fde", "turn", "coverage"}
