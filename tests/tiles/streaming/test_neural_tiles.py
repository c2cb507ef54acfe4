"""Neural tiles draw what their generators give, within budgets, and fall back to their splats."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from time import monotonic

import numpy as np
import pytest

from gsgen.conformance.fixtures.builders.moving import camera_dependent_model, drifting_model
from gsgen.contract.spec.geometry import rotation_matrix
from gsgen.contract.spec.manifest import Bounds
from gsgen.formats.shared.harmonics import sh_basis
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.playback.player import FrameRequest, Player
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene, SplatSet
from gsgen.runtime.scene.splat_data import SplatData
from gsgen.runtime.sources.generator_worker import GeneratorWorker
from gsgen.runtime.sources.stream_settings import StreamSettings
from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.format.volumes import Box
from gsgen.tiles.loading.leaves import read_contents
from gsgen.tiles.loading.tileset_loader import load_tileset
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.stores.folder_store import FolderStore
from gsgen.tiles.streaming import generator_opening
from gsgen.tiles.streaming.generator_rows import tile_rows
from gsgen.tiles.streaming.neural_tiles import NeuralTiles
from gsgen.tiles.streaming.session import SessionOptions, open_session
from gsgen.tiles.streaming.tiles_source import open_stream
from support.commands import gsgen_here
from tiles.streaming.neural_scenes import SPACING, generated, transforms, write_neural_tileset

pytestmark = pytest.mark.slow


HANGS_AFTER = 120.0  # seconds that no machine needs for a tile's run
BOUNDS = Bounds((-1.9, -1.9, -1.9), (1.9, 1.9, 1.9))


def moving(seed: int, degree: int | None = 1, count: int = 20) -> bytes:
    """A generator whose Gaussians drift with time, not the same for two seeds."""
    rng = np.random.default_rng(seed)
    spec = drifting_model(count, degree=degree).with_manifest(bounds=BOUNDS)
    spec = spec.with_weights(speed=rng.uniform(-0.4, 0.4, (count, 3)).astype(np.float32))
    model: bytes = spec.build().SerializeToString()
    return model


def watching(count: int) -> Camera:
    """A camera that sees ``count`` tiles."""
    middle = SPACING * (count - 1) / 2
    return Camera.look_at(
        (middle, -6 - 5 * count, 4), (middle, 0, 0), up=(0, 0, 1), width=96, height=64
    )


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    return Renderer(Device.open(), rasteriser="tiles")


def psnr(a: np.ndarray | None, b: np.ndarray | None) -> float:
    assert a is not None
    assert b is not None
    return float(10 * np.log10(1 / max(float(np.mean((a - b) ** 2)), 1e-12)))


def draw(index: Path, renderer: Renderer, camera: Camera, times: list[float], **settings: object):
    """Pictures of a tileset at some times, all finished; and the source, which is closed."""
    options = StreamSettings(max_error=0.01, **settings)  # type: ignore[arg-type]
    source = open_stream(index, settings=options)
    player = Player([source], renderer=renderer)
    try:
        pictures = [
            player.render(FrameRequest(camera, [{"time": time}])).rgba.copy() for time in times
        ]
    finally:
        source.close()
    return pictures, source


def content(index: Path, number: int) -> SplatSet:
    """The splats of a leaf, transformed by the renderer."""
    store = FolderStore(index.parent)
    tileset = load_tileset(store, index.name)
    tile = tileset.root.children[number]
    (placed,) = read_contents(store, tileset, [(tile, tile.contents[0])])
    return SplatSet(SplatData.from_splats(placed.relative_to_origin(np.zeros(3))))


@pytest.mark.parametrize("degree", [1, None])
def test_generators_are_drawn_at_the_frame_s_time(
    tmp_path: Path, renderer: Renderer, degree: int | None
) -> None:
    models = [moving(seed, degree) for seed in range(2)]
    index = write_neural_tileset(tmp_path / "tiles", models, seed=4)
    camera, times = watching(2), [0.0, 0.37, 5.0]  # times are clamped to the range
    pictures, source = draw(index, renderer, camera, times)
    assert source.time is not None
    assert source.time.range == (0, 1)
    for picture, time in zip(pictures, times, strict=True):
        value = {"time": np.float32([min(time, 1.0)])}
        sets = [
            generated(model, matrix, value)
            for model, matrix in zip(models, transforms(2, 4), strict=True)
        ]
        expected = renderer.render(Scene(sets), camera).rgba
        assert psnr(picture, expected) > 60
    assert psnr(pictures[0], pictures[1]) < 40
    splats = renderer.render(Scene([content(index, n) for n in range(2)]), camera).rgba
    assert psnr(pictures[0], splats) < 40


def test_a_generator_sees_the_camera_in_the_tile_s_frame(
    tmp_path: Path, renderer: Renderer
) -> None:
    model = (
        camera_dependent_model(degree=1).with_manifest(bounds=BOUNDS).build().SerializeToString()
    )
    index = write_neural_tileset(tmp_path / "tiles", [model], roles=("view",), seed=2)
    camera, (matrix,) = watching(1), transforms(1, 2)
    (picture,), source = draw(index, renderer, camera, [0.0])
    assert source.time is None
    # World to camera of the same camera, when the tile's frame is the world.
    scale = np.cbrt(np.linalg.det(matrix[:3, :3]))
    view = camera.view @ matrix
    view[:3] /= scale
    stored = view.T.astype(np.float32)  # column order
    expected = renderer.render(Scene([generated(model, matrix, {"view": stored})]), camera).rgba
    assert psnr(picture, expected) > 60


def model_leaving_its_bounds() -> bytes:
    spec = drifting_model(20, degree=1).with_manifest(bounds=BOUNDS)
    model: bytes = (
        spec.with_weights(speed=np.full((20, 3), 9, np.float32)).build().SerializeToString()
    )
    return model


def other_digest(index: Path) -> None:
    (index.parent / "t" / "0.onnx").write_bytes(moving(9))


def no_file(index: Path) -> None:
    (index.parent / "t" / "0.onnx").unlink()


def declare(**members: object) -> Callable[[Path], None]:
    def change(index: Path) -> None:
        document = json.loads(index.read_text())
        (extension,) = document["root"]["children"][0]["extensions"].values()
        extension |= members
        index.write_text(json.dumps(document))

    return change


def other_model(model: bytes) -> Callable[[Path], None]:
    def change(index: Path) -> None:
        (index.parent / "t" / "0.onnx").write_bytes(model)
        declare(sha256=hashlib.sha256(model).hexdigest())(index)

    return change


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (no_file, "does not exist"),
        (other_digest, "expected"),
        (other_model(b"no model"), "a Gaussian Generator"),
        (other_model(model_leaving_its_bounds()), "breaks the rules G"),
        (declare(splats_max=3), "20 or more"),
        (declare(splats_max=1 << 23), "the budget"),
    ],
    ids=["missing", "digest", "bytes", "leaving", "few", "many"],
)
def test_a_broken_generator_falls_back_and_one_line_names_the_tile(
    tmp_path: Path,
    renderer: Renderer,
    capfd: pytest.CaptureFixture[str],
    damage: Callable[[Path], None],
    message: str,
) -> None:
    index = write_neural_tileset(tmp_path / "tiles", [moving(0)])
    damage(index)
    (picture, again), _ = draw(index, renderer, watching(1), [0.5, 0.5])
    expected = renderer.render(Scene([content(index, 0)]), watching(1)).rgba
    assert psnr(picture, expected) > 60
    assert np.array_equal(picture, again)
    (line,) = capfd.readouterr().err.splitlines()
    assert "children[0]" in line
    assert message in line
    assert line.endswith("the tile's splats are drawn")


def test_a_run_that_breaks_a_promise_gives_the_splats_back(
    tmp_path: Path,
    renderer: Renderer,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What the probes of a validation did not see is found in the run itself."""
    monkeypatch.setattr(generator_opening, "check_neural_model", lambda *arguments, **_: iter(()))
    model = model_leaving_its_bounds()
    index = write_neural_tileset(tmp_path / "tiles", [model])
    camera = watching(1)
    (before, after), _ = draw(index, renderer, camera, [0.0, 1.0])
    (matrix,) = transforms(1)
    expected = renderer.render(
        Scene([generated(model, matrix, {"time": np.float32([0])})]), camera
    ).rgba
    assert psnr(before, expected) > 60
    assert psnr(after, renderer.render(Scene([content(index, 0)]), camera).rgba) > 60
    (line,) = capfd.readouterr().err.splitlines()
    assert "children[0]" in line
    assert "lie outside the tile" in line


def test_generators_run_on_the_execution_provider_that_was_asked_for(
    tmp_path: Path, renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    providers = []

    def open_worker(path: Path, provider: str, **_: object) -> GeneratorWorker:
        providers.append(provider)
        return GeneratorWorker(path, "cpu")  # the only one of every machine

    monkeypatch.setattr(generator_opening, "GeneratorWorker", open_worker)
    index = write_neural_tileset(tmp_path / "tiles", [moving(0)])
    settings = StreamSettings(max_error=0.01)
    source = open_stream(index, provider="webgpu", settings=settings)
    Player([source], renderer=renderer).render(FrameRequest(watching(1), [{"time": 0.0}]))
    source.close()
    assert providers == ["webgpu"]


def test_no_generator_runs_where_none_is_allowed(tmp_path: Path, renderer: Renderer) -> None:
    index = write_neural_tileset(tmp_path / "tiles", [moving(0)])
    (picture,), source = draw(index, renderer, watching(1), [0.5], neural_sessions=0)
    assert source.inputs == ()
    assert psnr(picture, renderer.render(Scene([content(index, 0)]), watching(1)).rgba) > 60


def test_rows_beyond_the_upload_budget_come_in_parts(
    tmp_path: Path, renderer: Renderer, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No frame uploads more than the budget; the pictures are those of whole uploads."""
    index = write_neural_tileset(tmp_path / "tiles", [moving(0, count=9000)], splats_max=9000)
    whole, _ = draw(index, renderer, watching(1), [0.2, 0.8])
    budget, parts, original_frame = 1_000_000, [], NeuralTiles.frame

    def take_parts(self: NeuralTiles, *frame: object, uploaded: int, **options: object) -> object:
        updates = original_frame(self, *frame, uploaded=uploaded, **options)  # type: ignore[arg-type]
        assert uploaded + sum(update.upload_bytes for update in updates) <= budget
        parts.extend(update.part for update in updates)
        return updates

    monkeypatch.setattr(NeuralTiles, "frame", take_parts)
    parted, source = draw(index, renderer, watching(1), [0.2, 0.8], upload_bytes=budget)
    assert parts == 2 * [slice(0, 4096), slice(4096, 8192), slice(8192, 9000)]
    for actual, expected in zip(parted, whole, strict=True):
        assert psnr(actual, expected) > 60
    assert psnr(*whole) < 50
    assert source.count == 9000


class SteppingClock:
    """A clock that stands still until it is moved."""

    time = 0.0

    def now(self) -> float:
        return self.time


def test_budgets_hold_while_a_camera_passes_many_tiles(tmp_path: Path) -> None:
    """Sessions, runs a second and uploaded bytes; slots hold a run's rows or the content's.

    The camera moves on while generators are opened and run. At every eighth step it stands still
    until the largest tiles show their runs, however long the machine takes for them.
    """
    rng = np.random.default_rng(0)
    count, sessions, rate, steps = 4, 2, 10.0, 160
    index = write_neural_tileset(tmp_path / "tiles", [moving(seed) for seed in range(count)])
    log, clock = tmp_path / "events.jsonl", SteppingClock()
    options = SessionOptions(
        max_error=0.01,
        cache_bytes=0,
        fade_seconds=0,
        slot_rows=64,
        max_splats=4096,
        neural_sessions=sessions,
        runs_per_second=rate,
        upload_budget=9000,
        log=log,
    )
    session = open_session(index, options)
    session._clock = clock
    neural = session.neural
    assert neural is not None
    neural._clock = clock
    shown: dict[int, bool] = {}
    opened: set[int] = set()
    frames = 0

    def draw_frame(camera: Camera, time: float) -> bool:
        """Draw a frame within the budgets; return whether the largest tiles show their runs."""
        nonlocal frames
        frames += 1
        clock.time += 0.05
        frame = session.frame(Frustum.from_camera(camera))
        for tile in frame.evicted:
            neural.evict(tile)
            shown.pop(tile, None)
        for arrival in frame.arrivals:
            assert arrival.reserved_rows == (40 if session.tree.level[arrival.tile] else 0)
            neural.arrive(arrival)
            shown[arrival.tile] = False
        uploaded = sum(arrival.upload_bytes for arrival in frame.arrivals)
        updates = neural.frame(
            camera,
            {"time": time},
            [entry.tile for entry in frame.drawn],
            uploaded=uploaded,
            is_complete=frame.missing == 0,
        )
        sizes = [entry.upload_bytes for entry in updates]
        assert uploaded + sum(sizes) <= options.upload_budget or len(sizes) == 1
        for entry in updates:
            assert entry.tile in shown
            shown[entry.tile] = len(entry.rows) == 20
        assert len(neural.open_tiles) <= sessions
        assert {tile for tile, is_run in shown.items() if is_run} <= set(neural.open_tiles)
        opened.update(neural.open_tiles)
        return frame.missing == 0 and not neural.pending_tiles

    for step in range(steps):
        middle = SPACING * (count - 1) * (step / (steps - 1))
        camera = Camera.look_at((middle, -9, 3), (middle, 0, 0), up=(0, 0, 1), width=96, height=64)
        time, deadline = rng.uniform(), monotonic() + HANGS_AFTER
        is_settled = draw_frame(camera, time)
        while not is_settled and step % 8 == 7:
            assert monotonic() < deadline, f"step {step} waits for tiles {neural.pending_tiles}"
            session.wait(0.01)
            neural.wait(0.1)
            is_settled = draw_frame(camera, time)
    session.close()
    events = _neural_events(log)
    assert opened == set(neural.tiles)
    assert len(opened) == count > sessions
    assert sum(len(entry["opened"]) for entry in events) >= len(opened)
    assert sum(len(entry["closed"]) for entry in events) >= len(opened) - sessions
    assert steps // 8 <= sum(len(entry["ran"]) for entry in events) <= rate * clock.time + sessions
    assert sum("drawn" in json.loads(line) for line in log.read_text().splitlines()) == frames


def _neural_events(log: Path) -> list[dict[str, list[int]]]:
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    return [line["neural"] for line in lines if "neural" in line]


def test_rows_follow_a_similarity() -> None:
    """Against the definitions: M p, M Σ Mᵀ, and colours along turned directions."""
    rng = np.random.default_rng(1)
    for degree in (0, 1, 3):
        count, terms = 7, (degree + 1) ** 2
        root = rng.normal(size=(count, 3, 3)) * 0.1
        covariance = root @ root.transpose(0, 2, 1)
        rows = np.zeros((count, 10), np.float32)
        rows[:, :3], rows[:, 3] = rng.uniform(-1, 1, (count, 3)), rng.uniform(0, 1, count)
        rows[:, 4:] = covariance[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
        colors = rng.normal(size=(count, 3 * terms)).astype(np.float32)
        turn = rotation_matrix(rng.normal(size=(1, 4)))[0]
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turn * 1.7, (100_000.5, 3, -7)
        arrival = tile_rows(
            3,
            rows,
            colors,
            space="sh",
            transform=matrix,
            box=Box(matrix[:3, 3], np.eye(3) * 4),
            sh_degree=2,
        )
        for row in range(count):
            center = matrix[:3, :3] @ rows[row, :3] + matrix[:3, 3]
            np.testing.assert_allclose(arrival.rows[row, :3] + arrival.origin, center, atol=1e-5)
            expected = matrix[:3, :3] @ covariance[row] @ matrix[:3, :3].T
            actual = arrival.rows[row, 4:]
            np.testing.assert_allclose(actual, expected[np.triu_indices(3)], atol=1e-5)
        random_directions = rng.normal(size=(20, 3))
        random_directions /= np.linalg.norm(random_directions, axis=1, keepdims=True)
        shared = min(degree, 2)
        used = (shared + 1) ** 2
        before = np.einsum(
            "dk,nkc->ndc",
            sh_basis(random_directions, shared),
            colors.reshape(count, terms, 3)[:, :used],
        )
        after = np.einsum(
            "dk,nkc->ndc",
            sh_basis(random_directions @ turn.T, 2),
            arrival.appearance.reshape(count, 9, 3),
        )
        np.testing.assert_allclose(after, before, atol=1e-4)


@pytest.mark.parametrize(
    ("row", "value", "message"),
    [
        ((2, 0), np.nan, "1 of 5 Gaussians are not finite, the first is row 2"),
        ((4, 7), np.inf, "not finite, the first is row 4"),
        ((1, 3), 1.5, "an invalid opacity, the first is row 1"),
        ((3, 1), -9.0, "lie outside the tile, the first is row 3"),
    ],
)
def test_rows_that_cannot_be_drawn_are_refused(
    row: tuple[int, int], value: float, message: str
) -> None:
    rows = np.full((5, 10), 0.1, np.float32)
    rows[row] = value
    colors = np.zeros((5, 3), np.float32)
    box = Box(np.zeros(3), np.eye(3))
    with pytest.raises(TilesetInvalid, match=message):
        tile_rows(0, rows, colors, space="rgb", transform=np.eye(4), box=box, sh_degree=0)
    rows[row[0]] = 0.1
    assert (
        len(tile_rows(0, rows, colors, space="rgb", transform=np.eye(4), box=box, sh_degree=0).rows)
        == 5
    )


def test_render_makes_a_film_of_neural_tiles(tmp_path: Path) -> None:
    index = write_neural_tileset(tmp_path / "tiles", [moving(0)])
    completed = gsgen_here(
        *("render", index, "-o", tmp_path / "film", "--frames", "2", "--sse", "0.1"),
        *("--width", "64", "--height", "48"),
    )
    assert completed.code == 0, completed.err
    assert "splats are drawn" not in completed.err
    first, second = (file.read_bytes() for file in sorted((tmp_path / "film").glob("*.png")))
    assert first != second
