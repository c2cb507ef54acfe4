"""`gsgen tiles replay`: a flight repeats itself, and a changed event log is told apart."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from gsgen.formats import write_ply
from gsgen.runtime.scene.camera import Camera
from gsgen.tiles.selection.frustum import Frustum
from gsgen.tiles.streaming.session import SessionOptions, open_session
from support.commands import Ran, gsgen_here
from support.tiles.builds import build
from support.tiles.tile_scenes import scattered

OPTIONS = SessionOptions(slot_rows=128, max_splats=40_000, cache_bytes=0, max_error=4.0)


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("town")
    write_ply(folder / "scene.ply", scattered(4_000, degree=1))
    build([folder / "scene.ply"], folder / "tiles")
    return folder / "tiles"


def fly(source: Path, options: SessionOptions, *, frames: int) -> None:
    """Fly towards the middle of the scene, and wait there until all is drawn."""
    session = open_session(source, options)
    is_complete, count = False, 0
    while not is_complete or count < frames:
        assert count < 600, "the cut never became complete"
        share = min(count / frames, 1.0)
        eye = (18 - 30 * share, -16 + 12 * share, 6.0)
        view = Camera.look_at(eye, (0.5, 0.2, 0), up=(0, 0, 1), width=640, height=360)
        is_complete = session.frame(Frustum.from_camera(view)).is_complete
        session.wait(0.01)
        count += 1
    session.close()


def test_a_log_replays_frame_by_frame(town: Path, tmp_path: Path) -> None:
    log = tmp_path / "events.jsonl"
    fly(town, replace(OPTIONS, log=log, upload_budget=20_000, max_splats=2000), frames=40)
    lines = log.read_text().splitlines()
    assert any(json.loads(line).get("evicted") for line in lines)
    frames = len(lines) - 1
    assert frames >= 40
    ran = gsgen_here("tiles", "replay", town, log)
    assert ran == Ran(0, f"{frames} frames: all decisions agree with the event log\n", "")
    ran = gsgen_here("tiles", "replay", town, log, "--json")
    assert json.loads(ran.out) == {"equal_frames": frames, "difference": None}


def test_a_changed_log_names_the_first_frame_that_differs(town: Path, tmp_path: Path) -> None:
    log = tmp_path / "events.jsonl"
    fly(town, replace(OPTIONS, log=log, fade_seconds=0), frames=5)
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    # Without the contents that came first, the replay can upload nothing in that frame.
    line = next(index for index, event in enumerate(lines) if event.get("arrived"))
    assert lines[line]["received"]
    logged = [
        list(pair) for pair in zip(lines[line]["arrived"], lines[line]["qualities"], strict=True)
    ]
    lines[line] |= {"received": [], "received_qualities": []}
    log.write_text("\n".join(map(json.dumps, lines)))
    ran = gsgen_here("tiles", "replay", town, log)
    assert ran.code == 1
    assert ran.out.startswith(f"frame {line} (line {line + 1}, ")
    # A busy machine receives several contents in a frame, in another order; a line holds some.
    begin = str([tuple(pair) for pair in logged[:3]]).removesuffix("]")
    assert f" is the first to differ: arrived []; the event log has {begin}" in ran.out
    ran = gsgen_here("tiles", "replay", town, log, "--json")
    assert ran.code == 1
    document = json.loads(ran.out)
    assert document["equal_frames"] == line - 1
    assert document["difference"] == {
        "frame": line,
        "line": line + 1,
        "time": lines[line]["t"],
        "decision": "arrived",
        "logged": logged,
        "replayed": [],
    }


def test_files_that_are_no_log_of_the_tileset_are_refused(town: Path, tmp_path: Path) -> None:
    log = tmp_path / "events.jsonl"
    fly(town, replace(OPTIONS, log=log), frames=1)
    record, frame, *_ = log.read_text().splitlines()
    write_ply(tmp_path / "other.ply", scattered(300, degree=0))
    build([tmp_path / "other.ply"], tmp_path / "other")

    def refusal(text: str | None, tileset: Path = town) -> tuple[int, str]:
        if text is not None:
            log.write_text(text)
        ran = gsgen_here("tiles", "replay", tileset, log)
        assert not ran.out
        return ran.code, " ".join(ran.err.split())

    code, line = refusal(None, tmp_path / "other")
    assert code == 2
    assert "is of another tileset" in line
    huge = json.dumps({**json.loads(frame), "t": 10**400})
    foreign = json.dumps({**json.loads(frame), "started": [10_000]})
    options = record.replace('"connections": 6', '"connections": 0')
    for text, message in (
        ("ply\nformat ascii 1.0\n", "the file is not an event log"),
        ("", "the file is not an event log"),
        (frame, "the file is not an event log"),
        (record, "the event log has no frames"),
        (f"{record}\n{frame[:90]}", "events.jsonl, line 2: the text is not JSON"),
        (f"{record}\n{huge}", "events.jsonl, line 2: the line is not a frame"),
        (f"{record}\n{foreign}", "line 2: the event log names tile 10000, expected 0 to"),
        (f"{options}\n{frame}", "session.options.connections: 0; expected a whole number from 1"),
    ):
        code, line = refusal(text)
        assert code == 4
        assert message in line
    log.unlink()
    code, line = refusal(None)
    assert code == 4
    assert "the event log cannot be read: No such file" in line
