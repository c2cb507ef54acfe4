"""Commands that draw run models in one confined process, and end at its limits with one line."""

import time
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from gsgen.conformance.fixtures.builders.moving import drifting_model
from gsgen.contract.spec.manifest import Bounds
from gsgen.formats import write_ply
from gsgen.reference_plugins.samples import garden
from gsgen.sdk.binding.confined import models as confined_models
from support.commands import gsgen, gsgen_here
from support.models.hostile import HOSTILE
from tiles.streaming.neural_scenes import write_neural_tileset

SECONDS = 3
BOUNDS = Bounds((-1.9, -1.9, -1.9), (1.9, 1.9, 1.9))


@pytest.fixture
def children(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The command lines of the confined processes that were started."""
    started: list[list[str]] = []
    popen = confined_models.subprocess.Popen

    def record(words: list[str], **options: object) -> object:
        started.append(words)
        return popen(words, **options)  # type: ignore[call-overload]

    monkeypatch.setattr(confined_models.subprocess, "Popen", record)
    return started


def test_pictures_of_confined_and_trusted_models_are_equal(
    tmp_path: Path, children: list[list[str]]
) -> None:
    paths = [find("drift").write(tmp_path), find("post_process_any_size").write(tmp_path)]
    words = ["render", str(paths[0]), "--post", str(paths[1]), "--frames", "3", "--size", "64x48"]
    for folder, trust in (("confined", []), ("trusted", ["--trust"])):
        result = gsgen_here(*words, "-o", str(tmp_path / folder), *trust)
        assert (result.code, result.err) == (0, "")
        assert len(children) == 1  # for both models, and none for trusted ones
    pictures = [sorted((tmp_path / name).iterdir()) for name in ("confined", "trusted")]
    assert len(pictures[0]) == 3
    assert [p.read_bytes() for p in pictures[0]] == [p.read_bytes() for p in pictures[1]]


def test_drawing_a_splat_file_starts_no_process(tmp_path: Path, children: list[list[str]]) -> None:
    write_ply(tmp_path / "garden.ply", garden(2_000))
    words = ["render", str(tmp_path / "garden.ply"), "-o", str(tmp_path / "a.png"), "--size", "8x8"]
    assert gsgen_here(*words).code == 0
    assert children == []


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
@pytest.mark.parametrize(
    "words",
    [("render", "-o", "picture.png"), ("bake", "-o", "splats.ply"), ("bench-render",)],
    ids=lambda words: words[0],
)
def test_a_hostile_model_ends_a_command_at_a_limit_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, words: tuple[str, ...]
) -> None:
    path = HOSTILE[name](tmp_path)
    monkeypatch.chdir(tmp_path)
    command, *options = words
    start_time = time.monotonic()
    result = gsgen(command, str(path), *options, "--timeout", str(SECONDS))
    assert time.monotonic() - start_time < SECONDS + 10  # a child and imports of a busy machine
    assert result.code == 2
    (line,) = result.err.splitlines()
    assert "limit (--" in line
    assert str(path) in line
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_neural_tile_draws_its_splats_with_one_line(tmp_path: Path, name: str) -> None:
    honest_model = drifting_model(20, degree=1).with_manifest(bounds=BOUNDS).build()
    hostile_model = HOSTILE[name](tmp_path).read_bytes()
    models = [honest_model.SerializeToString(), hostile_model]
    index = write_neural_tileset(tmp_path / "tiles", models)
    options = ("--size", "48x32", "--sse", "0.1", "--timeout", str(SECONDS))
    result = gsgen("render", str(index), "-o", str(tmp_path / "a.png"), *options)
    assert result.code == 0
    (line,) = result.err.splitlines()
    assert "t/1.onnx" in line
    assert line.endswith("the tile's splats are drawn")
