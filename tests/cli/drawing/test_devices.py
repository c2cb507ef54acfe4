"""Commands that draw, on devices that fail: what is said, and that nothing half is left."""

import json
from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np
import pytest

from gsgen.conformance.fixtures import find
from support.commands import gsgen_here
from support.rendering.failing_devices import bindings_of, lost_at, memory_of

SMALL_SIZE_ARGS = ("--width", "64", "--height", "48")
TILES = ("--rasteriser", "tiles")
DRAWING = {
    "render": ("render", "cloud.npz", "-o", "out.gif", "--frames", "3", *SMALL_SIZE_ARGS, *TILES),
    "bench-render": (
        "bench-render",
        "cloud.npz",
        "-o",
        "out.json",
        "--frames",
        "3",
        *SMALL_SIZE_ARGS,
    ),
}
ROWS = 3000
COMPACT_MEMORY = 960_000  # bytes for the picture and compact rows, and not for others


@pytest.fixture(autouse=True)
def _cloud(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three thousand Gaussians of degree 2: 16 kB of them are 100 kB of harmonics."""
    rng = np.random.default_rng(0)
    rows = np.zeros((ROWS, 10), np.float32)
    rows[:, :3] = rng.normal(size=(ROWS, 3))
    rows[:, 3], rows[:, [4, 7, 9]] = 0.8, 0.02
    color = rng.uniform(size=(ROWS, 27)).astype(np.float32)
    np.savez(tmp_path / "cloud.npz", gaussians=rows, appearance=color)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("command", DRAWING)
@pytest.mark.parametrize("frame", [0, 2])
def test_a_lost_device_ends_a_command(command: str, frame: int) -> None:
    with lost_at(frame):
        completed = gsgen_here(*DRAWING[command])
    assert completed.code == 2, completed.err
    message = completed.err[completed.err.index("gsgen:") :].splitlines()
    assert message[0].startswith("gsgen: the graphics device was lost: ")
    assert "smaller image" in message[1]
    assert not list(Path().glob("out.*"))


@pytest.mark.parametrize("command", DRAWING)
def test_out_of_memory_error_names_the_request_and_its_size(command: str) -> None:
    with memory_of(400_000):
        completed = gsgen_here(*DRAWING[command])
    assert completed.code == 2, completed.err
    # Rows have 40 bytes, their 27 numbers 112; packed, and in float16, 32 and 64.
    assert f"{ROWS:,} Gaussians take {ROWS * (40 + 112):,} bytes" in completed.err
    assert f"With `--compact` (`compact=True`) they take {ROWS * (32 + 64):,}." in completed.err
    assert "needs 336,000 bytes, but the memory of" in completed.err
    assert "gsgen: appearance: " in completed.err
    assert "--sh-degree 0" in completed.err
    assert not list(Path().glob("out.*"))


def test_suggested_options_take_less_memory() -> None:
    with memory_of(COMPACT_MEMORY):
        assert gsgen_here(*DRAWING["render"]).code == 2
    with memory_of(COMPACT_MEMORY):
        completed = gsgen_here(*DRAWING["render"], "--compact")
    assert completed.code == 0, completed.err
    assert Path("out.gif").exists()


@pytest.mark.parametrize(
    ("device", "reason"),
    [(lost_at(0), "the graphics device was lost"), (memory_of(1000), "the memory of")],
    ids=["lost", "full"],
)
def test_a_level_that_a_device_fails_at_is_skipped_with_the_reason(
    device: AbstractContextManager[None], reason: str
) -> None:
    model = find("still_sh3").write(Path())
    with device:
        completed = gsgen_here("validate", model, "--level", "render", "--format", "json")
    assert completed.code == 0, completed.err
    (level,) = (
        entry for entry in json.loads(completed.out)["levels"] if entry["level"] == "render"
    )
    assert level["status"] == "skipped"
    assert reason in level["reason"]


def test_image_whose_tile_row_exceeds_a_binding_is_refused() -> None:
    with bindings_of(1 << 20):
        completed = gsgen_here("render", "cloud.npz", "-o", "out.png", "--width", "4096")
    assert completed.code == 2, completed.err
    assert "color image: would take 2,097,152 bytes" in completed.err
    assert len(completed.err.strip().splitlines()) == 2
    assert not Path("out.png").exists()
