import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsgen.formats import (
    FileTruncated,
    FormatError,
    FormatWarning,
    Splats,
    ValueInvalid,
    read_ply,
    read_splat,
    write_splat,
)
from support.commands import shared
from support.splat_files import assert_near, opacity, scene, turn_between, unit

C0 = 0.28209479177387814


def test_records_follow_the_format(tmp_path):
    splats = scene(3, 2)
    write_splat(tmp_path / "a.splat", splats)
    records = [*struct.iter_unpack("<6f8B", (tmp_path / "a.splat").read_bytes())]
    assert len(records) == 3
    for row, record in enumerate(records):
        np.testing.assert_array_equal(np.float32(record[:3]), splats.position[row])
        np.testing.assert_allclose(record[3:6], np.exp(splats.log_scale[row]), rtol=1e-6)
        shown = np.clip((0.5 + C0 * splats.sh[row, 0]) * 255, 0, 255)
        np.testing.assert_allclose(record[6:9], shown, atol=0.51)
        np.testing.assert_allclose(record[9], opacity(splats)[row] * 255, atol=0.51)
        turn = np.clip(unit(splats.rotation[row : row + 1])[0] * 128 + 128, 0, 255)
        np.testing.assert_allclose(record[10:], turn, atol=0.51)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), degree=st.integers(0, 4))
def test_round_trip_error_is_within_half_a_step(tmp_path_factory, seed, degree):
    splats = scene(8, degree, seed)
    file = tmp_path_factory.getbasetemp() / "round.splat"
    write_splat(file, splats)
    restored = read_splat(file)
    np.testing.assert_array_equal(restored.position, splats.position)
    assert np.abs(restored.log_scale - splats.log_scale).max() <= 1e-6
    assert np.abs(opacity(restored) - opacity(splats)).max() <= 1 / 509
    cut = np.clip(splats.sh[:, :1], -0.5 / C0, 0.5 / C0)
    assert np.abs(restored.sh - cut).max() <= 1 / 509 / C0
    assert turn_between(restored.rotation, splats.rotation) <= 1.5 / 128  # 1 is cut to 127/128


def test_rewriting_gives_the_same_bytes(tmp_path):
    first, other = tmp_path / "one", tmp_path / "other"
    write_splat(first, scene(50, 0))
    write_splat(other, read_splat(first))
    a, b = (np.frombuffer(file.read_bytes(), np.uint8).reshape(-1, 32) for file in (first, other))
    np.testing.assert_array_equal(a[:, :12], b[:, :12])
    np.testing.assert_array_equal(a[:, 24:28], b[:, 24:28])
    assert np.abs(a[:, 28:].astype(int) - b[:, 28:]).max() <= 1


def test_splat_and_ply_of_one_training_agree():
    name = "data/twins/test-splat.3-points-from-train"
    with pytest.warns(FormatWarning, match="not used: properties nx, ny, nz"):
        source_splats = read_ply(shared(f"{name}.ply"))
    twin = read_splat(shared(f"{name}.splat"))
    splats = Splats(
        position=source_splats.position,
        rotation=source_splats.rotation,
        log_scale=source_splats.log_scale,
        logit_opacity=source_splats.logit_opacity,
        sh=source_splats.sh[:, :1],
    )
    assert_near(splats, twin, rotation=0.02, log_scale=1e-6, opacities=1 / 255, sh=1 / 70)


def test_extreme_values_are_clamped(tmp_path):
    original = scene(2, 0)
    odd = Splats(
        position=original.position,
        rotation=np.float32([[1e-30, 0, 0, 0], [-1, 0, 0, 0]]),
        log_scale=np.float32([[-np.inf, -100, 80]] * 2),
        logit_opacity=np.float32([np.inf, -np.inf]),
        sh=np.float32([[[9, -9, 0]]] * 2),
    )
    write_splat(tmp_path / "odd.splat", odd)
    restored = read_splat(tmp_path / "odd.splat")
    np.testing.assert_allclose(restored.log_scale, odd.log_scale, rtol=1e-2)
    np.testing.assert_array_equal(restored.logit_opacity, odd.logit_opacity)
    np.testing.assert_array_equal(restored.rotation, [[1, 0, 0, 0], [-1, 0, 0, 0]])
    np.testing.assert_allclose(restored.sh[0, 0], [0.5 / C0, -0.5 / C0, 0], atol=0.01)


@pytest.mark.parametrize(
    ("offset", "value", "text"),
    [
        (0, np.nan, "position[:, 0]: 1 of 2 rows are invalid: row 0 is nan\nexpected a finite number"),
        (9, np.inf, "position[:, 1]: 1 of 2 rows are invalid: row 1 is inf\nexpected a finite number"),
        (3, -1.0, "log_scale[:, 0]: 1 of 2 rows are invalid: row 0 is nan\n"
         "expected a finite number or -inf"),
    ],
)  # fmt: skip
def test_values_that_cannot_be_drawn_are_refused(tmp_path, offset, value, text):
    file = tmp_path / "bad.splat"
    write_splat(file, scene(2, 0))
    numbers = np.frombuffer(file.read_bytes(), "<f4").copy()
    numbers[offset] = value
    file.write_bytes(numbers.tobytes())
    with pytest.raises(ValueInvalid) as caught:
        read_splat(file)
    hint = "`gsgen convert --drop-invalid` writes a file without such rows"
    assert str(caught.value) == f"{file}: {text}\n{hint}"


def test_a_part_of_a_record_is_refused(tmp_path):
    file = tmp_path / "short.splat"
    file.write_bytes(bytes(77))
    with pytest.raises(FileTruncated) as caught:
        read_splat(file)
    assert str(caught.value) == (
        f"{file}: byte 64: the file of 77 bytes holds 2 records of 32, and 13 bytes more\n"
        "expected a multiple of 32 bytes, as of a SPLAT file\ncopy or download the file again"
    )


def test_a_scale_beyond_float32_is_not_written(tmp_path):
    original = scene(1, 0)
    oversized_splats = Splats(
        position=original.position,
        rotation=original.rotation,
        log_scale=original.log_scale + 100,
        logit_opacity=original.logit_opacity,
        sh=original.sh,
    )
    with pytest.raises(FormatError, match="at most 88, a natural logarithm"):
        write_splat(tmp_path / "a.splat", oversized_splats)
    assert not list(tmp_path.iterdir())
