"""The demo: run whole, as ``make demo`` does, and its plugins one by one."""

import os
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from support.reports.pages import DOCS


@pytest.fixture(scope="module")
def demo() -> ModuleType:
    spec = spec_from_file_location("demo_families", DOCS / "examples" / "demo_families.py")
    assert spec is not None
    assert spec.loader is not None
    result = module_from_spec(spec)
    sys.modules["demo_families"] = result  # dataclasses look their module up
    spec.loader.exec_module(result)
    return result


@pytest.mark.slow
def test_the_whole_demo_runs_without_the_captured_scene(tmp_path: Path) -> None:
    demo = DOCS / "examples" / "demo.py"
    completed = subprocess.run(
        [sys.executable, demo, tmp_path / "out", "static"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ | {"GSGEN_SHARED": str(tmp_path / "absent")},
    )
    assert completed.returncode == 0, completed.stderr
    for rule in ("GV003", "GV014", "GV001", "GO011"):
        assert f"  {rule} " in completed.stdout
    assert completed.stdout.count("  hint: ") == 4
    assert "static " in completed.stdout.partition("picture:")[0].splitlines()[-1]
    drawn = ["views/frame_0002.png", "depth/frame_0002.png", "orbit.mp4", "families/static.png"]
    assert [name for name in drawn if not (tmp_path / "out" / name).is_file()] == []


def test_family_is_exported_validated_and_drawn(demo: ModuleType, tmp_path: Path) -> None:
    result = demo.make("static", tmp_path / "static")
    assert (result.name, result.gaussians, result.verdict) == ("static", 20_000, "conforms")
    assert result.size == (tmp_path / "static" / "static.onnx").stat().st_size
    assert result.milliseconds > 0
    typed_commands = (tmp_path / "static" / "commands.txt").read_text("utf-8")
    assert typed_commands.startswith("$ gsgen export static ")
    assert "$ gsgen render " in typed_commands
    with Image.open(result.strip) as strip:
        assert strip.size == (6 * 240, 240)
        tiles = np.split(np.asarray(strip), 6, axis=1)
    background_color = np.array([0x16, 0x18, 0x1D])
    for tile in tiles:
        assert np.abs(tile[0, 0].astype(int) - background_color).max() <= 1
        actual = (np.abs(tile.astype(int) - background_color).max(axis=2) > 40).mean()
        assert 0.1 < actual < 0.6  # of the picture: neither empty nor too near
        rows, columns = np.nonzero(np.abs(tile.astype(int) - background_color).max(axis=2) > 40)
        assert min(rows.min(), columns.min()) > 3  # not cut off
        assert max(rows.max(), columns.max()) < 236
    assert not np.array_equal(tiles[0], tiles[1])
    assert "static" in demo.table([result])


def test_demo_without_a_driver_reports_it(
    demo: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reason = "gsgen: no adapter was found"
    monkeypatch.setattr(demo, "gsgen", lambda *_: (2, "", f"{reason}\n"))
    strip, error_text = demo.draw(
        demo.demo_plugins()["gauhuman"], tmp_path / "m.onnx", tmp_path, tmp_path / "log"
    )
    assert (strip, error_text) == (None, reason)
    row = demo.DemoModel(
        name="gauhuman",
        gaussians=10,
        size=2048,
        verdict="conforms",
        level="behaviour",
        milliseconds=1.0,
        strip=None,
        trouble=reason,
    )
    assert "conforms (behaviour); picture: not drawn" in demo.table([row])


def test_a_command_that_fails_stops_the_demo(demo: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match=r"gsgen validate none\.onnx ended with 4"):
        demo.required(tmp_path / "log", "validate", "none.onnx")
