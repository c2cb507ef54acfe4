"""`gsgen tiles build` as a user runs it."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import write_ply
from gsgen.tiles.build.build import WORK_FOLDER
from support.tiles.tile_scenes import digests, scattered


def gsgen(*words: object) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "gsgen.cli", "tiles", "build", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "scene.ply"
    write_ply(path, scattered(20_000))
    return path


def test_build_command_prints_splats_then_up_to_date(scene, tmp_path):
    completed = gsgen(scene, "-o", tmp_path / "tiles", "--leaf", 2000, "--workers", 2)
    assert completed.returncode == 0, completed.stderr
    assert "20,000 splats" in completed.stdout
    assert completed.stderr == ""
    again = gsgen(scene, "-o", tmp_path / "tiles", "--leaf", 2000, "--engine", "serial")
    assert "up to date" in again.stdout


def test_json_lines_report_phases_and_the_result(scene, tmp_path):
    completed = gsgen(
        scene, "-o", tmp_path / "tiles", "--engine", "serial", "--json", "--quality", 3
    )
    assert completed.returncode == 0, completed.stderr
    events = [json.loads(line) for line in completed.stdout.splitlines()]
    phases = list(dict.fromkeys(event["phase"] for event in events if "phase" in event))
    assert phases == ["scan", "count", "bin", "tiles", "index"]
    for phase in phases[:-1]:
        last = [event for event in events if event.get("phase") == phase][-1]
        assert last["done"] == last["total"] == 20_000
    assert events[-1]["event"] == "done"
    assert events[-1]["splats"] == 20_000
    assert (tmp_path / "tiles" / "tileset-q4.json").exists()


def test_ctrl_c_leaves_a_folder_that_goes_on(scene, tmp_path):
    words = (scene, "-o", tmp_path / "tiles", "--leaf", "60", "--engine", "serial")
    with subprocess.Popen(
        [sys.executable, "-m", "gsgen.cli", "tiles", "build", *map(str, words)],
        stderr=subprocess.PIPE,
        text=True,
    ) as running:
        end = time.monotonic() + 100
        while len(list((tmp_path / "tiles").glob("t/*/*.glb"))) < 5:
            assert running.poll() is None, running.communicate()
            assert time.monotonic() < end
            time.sleep(0.005)
        running.send_signal(signal.SIGINT)
        message = running.communicate(timeout=60)[1]
    assert running.returncode == 130
    assert "the same command goes on" in message
    assert "Traceback" not in message
    assert (tmp_path / "tiles" / WORK_FOLDER).is_dir()
    completed = gsgen(*words)
    assert completed.returncode == 0, completed.stderr
    assert gsgen(*words[:1], "-o", tmp_path / "other", *words[3:]).returncode == 0
    assert digests(tmp_path / "tiles") == digests(tmp_path / "other")


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--engine", "dusk"], 2, "Did you mean 'dask'?"),
        (["--engine", "dask=tcp://127.0.0.1:9", "--workers", "1"], 2, "no Dask scheduler"),
        (["--lon", "3"], 2, "--lat missing"),
        (["--height", "3"], 2, "--lon and --lat missing"),
        (["--lon", "300", "--lat", "1"], 2, "--lon: is 300"),
        (["--transform", "none.json"], 2, "none.json: cannot be read"),
        (["--transform", "none.json", "--lon", "3"], 2, "cannot be combined with"),
        (["--leaf", "0"], 2, "leaf"),
        (["missing.ply"], 4, "missing.ply: cannot be read"),
    ],
)
def test_invalid_build_options_are_explained(scene, tmp_path, monkeypatch, options, code, words):
    if any(option.startswith("dask=") for option in options):
        pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    completed = gsgen(scene, "-o", tmp_path / "tiles", *options)
    assert completed.returncode == code, completed.stderr
    assert words in completed.stderr
    assert "Traceback" not in completed.stderr
    assert not (tmp_path / "tiles" / "tileset.json").exists()


def test_a_place_on_the_globe_is_in_the_transform(scene, tmp_path):
    completed = gsgen(
        scene, "-o", tmp_path / "t", "--lon", 8.5, "--lat", 47.4, "--engine", "serial"
    )
    assert completed.returncode == 0, completed.stderr
    root = json.loads((tmp_path / "t" / "tileset.json").read_text())["root"]
    assert np.linalg.norm(root["transform"][12:15]) == pytest.approx(6.367e6, rel=1e-2)
