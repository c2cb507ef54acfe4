"""Conversion in parts: the bytes of a conversion in memory, and its errors."""

from pathlib import Path

import numpy as np
import pytest

from gsgen.formats import (
    Splats,
    ValueInvalid,
    codec_named,
    conversion,
    parts,
    read_ply,
    read_sog,
    write_ply,
)
from gsgen.formats.conversion import convert
from gsgen.formats.editing.edits import parse_edit
from gsgen.formats.parts import open_parts
from gsgen.formats.sog.palette import make_palette, nearest_entries
from gsgen.formats.sog.write import sog_order
from support.splat_files import scene

EDITS = [
    [],
    [("where", "opacity>=0.3"), ("box", "-9,-9,-9,9,9,0.5")],
    [("rotate", "10,20,30"), ("scale", "2"), ("translate", "1,2,3"), ("sphere", "0,0,0,4")],
]


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(parts, "_CHUNK_ROWS", 7)
    write_ply(tmp_path / "source.ply", scene(100, 2))
    return tmp_path / "source.ply"


@pytest.mark.parametrize("degree", [None, 1])
@pytest.mark.parametrize("edits", EDITS)
@pytest.mark.parametrize("name", ["ply", "sog", "spz"])
def test_parts_give_the_bytes_of_a_conversion_in_memory(
    source: Path,
    name: str,
    edits: list[tuple[str, str]],
    degree: int | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    results = []
    for label, limit in (("whole", 1 << 29), ("parts", 0)):
        monkeypatch.setattr(conversion, "MAX_COMPARED_VALUES", limit)
        target = source.with_name(f"{label}.{name}")
        parsed = [parse_edit(*edit) for edit in edits]
        results.append(convert(source, target, codec_named(name), sh_degree=degree, edits=parsed))
    whole, in_parts = results
    assert (whole.compared, in_parts.compared) == (True, False)
    assert whole.count == in_parts.count > 0
    assert (whole.degree, whole.lost, whole.sizes) == (
        in_parts.degree,
        in_parts.lost,
        in_parts.sizes,
    )
    assert Path(whole.target).read_bytes() == Path(in_parts.target).read_bytes()


@pytest.mark.parametrize("name", ["whole", "parts"])
def test_harmonics_are_read_in_batches_of_one_size(
    source: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sample that chooses a palette and the labels do not depend on the size of the parts."""
    monkeypatch.setattr("gsgen.formats.sog.write._CHUNK_ROWS", 16)
    monkeypatch.setattr("gsgen.formats.sog.palette._MAX_TRAINING_ROWS", 30)
    monkeypatch.setattr(conversion, "MAX_COMPARED_VALUES", {"whole": 1 << 29, "parts": 0}[name])
    result = convert(source, source.with_name("out.sog"), codec_named("sog"))
    splats = read_ply(source)
    order = sog_order(splats)
    higher = splats.sh[:, 1:].reshape(100, -1)
    palette = make_palette(higher[::4], 64)  # 25 rows, each of which has an entry of its own
    decoded = read_sog(result.target).sh[:, 1:].reshape(100, -1)
    labels = nearest_entries(higher, palette)
    np.testing.assert_allclose(decoded, palette[labels][order], atol=0.02)
    np.testing.assert_allclose(palette[labels[::4]], higher[::4])


def test_only_edits_of_single_rows_go_in_parts(source: Path) -> None:
    by_row, global_edit = parse_edit("scale", "2"), parse_edit("decimate", "50%")
    assert open_parts(source, [by_row], min_bytes=0) is not None
    assert open_parts(source, [by_row, global_edit], min_bytes=0) is None
    assert open_parts(source, [lambda splats: splats], min_bytes=0) is None
    assert open_parts(source, [], min_bytes=1 << 20) is None


def test_edits_that_leave_nothing_are_an_error(source: Path) -> None:
    stream = open_parts(source, [parse_edit("where", "opacity>2")], min_bytes=0)
    assert stream is not None
    with pytest.raises(ValueInvalid, match="--where opacity>2 leaves none of 100 splats"):
        stream.measure_extent()


def test_a_value_that_cannot_be_drawn_is_found_in_its_part(source: Path) -> None:
    splats: Splats = scene(100, 0)
    splats.position[45, 1] = np.nan
    with pytest.raises(ValueInvalid):
        write_ply(source, splats)
    rows = np.fromfile(source, np.uint8)
    body = rows.size - 100 * (3 + 3 + 24 + 8) * 4
    rows[body + 45 * 38 * 4 :][:4] = np.array([np.nan], "<f4").view(np.uint8)
    rows.tofile(source)
    stream = open_parts(source, [], min_bytes=0)
    assert stream is not None
    with pytest.raises(ValueInvalid, match="rows from 42 on") as caught:
        stream.measure_extent()
    assert caught.value.path == str(source)
