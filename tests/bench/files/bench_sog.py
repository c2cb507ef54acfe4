"""SOG files of gsgen beside those of splat-transform: bytes and errors on three scenes.

    scripts/fetch.sh splat-transform
    python -m pytest tests/bench/files/bench_sog.py -o python_files='bench_*.py' \
        -o python_functions='bench_*' -s -q

Each program also reads the other's file.
"""

import math
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gsgen.formats import Splats, differences, read_ply, read_sog, write_ply, write_sog
from gsgen.formats.shared.quantities import SH_C0, sigmoid, unit
from gsgen.formats.sog.write import sog_order
from support.measures import print_figure
from support.splat_files import FIELDS, scene
from support.tiles.level_scenes import SHARED, garden, knot

TOOL = Path(__file__).parents[3] / ".venv/npm/splat-transform-3.7.0/bin/cli.mjs"
BYTES_BAR = 1.05
_EQUAL = 1e-9  # errors that differ by less come from the sums


def transform(source: Path, target: Path) -> None:
    """Convert a file with splat-transform, on the processor alone."""
    if not TOOL.exists():
        pytest.fail(f"missing: {TOOL}; hint: run scripts/fetch.sh splat-transform")
    words = ["node", str(TOOL), "-q", "-w", "-g", "cpu", str(source), str(target)]
    subprocess.run(words, check=True, capture_output=True)


def scenes() -> Iterator[tuple[str, Splats]]:
    """A textured object of degree 3, points of a real capture, and noise of degree 1."""
    yield "knot", knot()
    if not (SHARED / "data" / "garden").is_dir():
        pytest.fail("missing: data/garden of the shared data; hint: set GSGEN_SHARED")
    yield "garden", garden()[0]
    yield "noise", scene(8_000, 1)


def features(splats: Splats) -> np.ndarray:
    """Positions, to find each splat in another order; the other numbers only break ties."""
    turns = unit(splats.rotation)
    turns = turns * np.sign(turns[np.arange(len(turns)), np.abs(turns).argmax(axis=1)])[:, None]
    columns = [
        1e5 * splats.position,
        10 * splats.log_scale,
        100 * sigmoid(splats.logit_opacity)[:, None],
        100 * SH_C0 * splats.sh[:, 0],
        10 * turns,
    ]
    return np.column_stack(columns).astype(np.float64)


def matched(source: Splats, decoded: Splats) -> np.ndarray:
    """Return the row of ``source`` for each row of ``decoded``, whose order is not known."""
    return np.asarray(cKDTree(features(source)).query(features(decoded))[1])


def taken(source: Splats, rows: np.ndarray) -> Splats:
    return replace(source, **{name: getattr(source, name)[rows] for name in FIELDS})


def bench_bytes_and_errors(tmp_path: Path) -> None:
    """gsgen takes at most 1.05 times the bytes, at the same or a smaller error."""
    for name, splats in scenes():
        source = tmp_path / f"{name}.ply"
        files = {program: tmp_path / f"{name}-{program}.sog" for program in ("theirs", "ours")}
        write_ply(source, splats)
        write_sog(files["ours"], splats)
        transform(source, files["theirs"])
        sizes = {program: file.stat().st_size for program, file in files.items()}
        ratio = sizes["ours"] / sizes["theirs"]
        print_figure(
            f"{name}: {len(splats):,} splats of degree {splats.degree}: {sizes['ours']:,} bytes, "
            f"splat-transform {sizes['theirs']:,}, {ratio:.3f} × (bar {BYTES_BAR})"
        )
        errors: dict[str, dict[str, float]] = {}
        for program, file in files.items():
            decoded = read_sog(file)
            order = sog_order(splats) if program == "ours" else matched(splats, decoded)
            entries = differences(taken(splats, order), decoded)
            errors[program] = {entry.name: entry.typical for entry in entries}
        for quantity, theirs in errors["theirs"].items():
            ours = errors["ours"][quantity]
            print_figure(f"  {quantity:10s} rms error {ours:.3g}, splat-transform {theirs:.3g}")
            assert ours <= theirs + _EQUAL, (name, quantity)
        assert ratio <= BYTES_BAR
        decoded_there = tmp_path / "decoded.ply"
        transform(files["ours"], decoded_there)
        here, reference = read_sog(files["ours"]), read_ply(decoded_there)
        for entry in differences(here, reference):
            assert entry.largest <= (0.1 if entry.name == "rotation" else 1e-3), (name, entry)
        print_figure(
            f"  splat-transform reads gsgen's file alike, to {_max_errors(here, reference):.1e}"
        )


def _max_errors(here: Splats, decoded: Splats) -> float:
    pairs = (
        (getattr(here, name), getattr(decoded, name)) for name in ("position", "log_scale", "sh")
    )
    return max((float(np.abs(a - b).max()) for a, b in pairs), default=math.nan)
