"""Rows that do not correspond are found and matched; a Gaussian is never blended with another."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gsgen.contract.errors import ConfigInvalid
from gsgen.sdk.errors import GeneratorInvalid
from gsgen.sdk.exporting.constant_generator import ConstantRows
from gsgen.sdk.sequences.clip_source import ClipSource
from gsgen.sdk.sequences.correspondence import agreeing_share, rows_correspond
from gsgen.sdk.sequences.matching import match_rows
from sdk.sequences.test_clips import STATIC, random_frames, run, source


def smooth_frames(seed: int, *, rows: int = 400, frames: int = 8) -> list[ConstantRows]:
    """Return a cloud that bends: Gaussians move by several sizes a frame, neighbours alike."""
    (first,) = random_frames(seed, rows=rows, frames=1)
    sequence = []
    for number in range(frames):
        packed = first.rows.copy()
        x, _, z = packed[:, :3].T
        packed[:, 1] += 0.3 * np.sin(0.5 * number + 0.7 * x) + 0.1 * number * z
        packed[:, 3] = 0.8
        sequence.append(replace(first, rows=packed))
    return sequence


def permuted(frame: ConstantRows, order: np.ndarray) -> ConstantRows:
    return replace(frame, rows=frame.rows[order], appearance=frame.appearance[order])


def along_a_curve(frame: ConstantRows) -> ConstantRows:
    """Return a frame as formats write it that sort rows: near ones have near numbers."""
    cells = np.floor((frame.rows[:, :3] - frame.rows[:, :3].min(axis=0)) * 8).astype(int)
    keys = sum(
        ((cells[:, axis] >> bit) & 1) << (3 * bit + axis) for axis in range(3) for bit in range(8)
    )
    return permuted(frame, np.argsort(keys, kind="stable"))


@pytest.mark.parametrize("seed", range(3))
def test_reordered_rows_do_not_correspond(seed: int) -> None:
    first, second = smooth_frames(seed, rows=3000)[2:4]
    assert agreeing_share(first, second) > 0.9
    assert not rows_correspond(first, permuted(second, np.arange(2999)))
    order = np.random.default_rng(seed).permutation(len(first.rows))
    for other in (permuted(second, order), along_a_curve(second)):
        assert agreeing_share(along_a_curve(first), other) < 0.05


def test_without_visible_rows_nothing_contradicts() -> None:
    (frame,) = random_frames(0, frames=1)
    frame.rows[:, 3] = 0
    assert agreeing_share(frame, frame) == 1
    none = permuted(frame, np.arange(0))
    assert agreeing_share(none, none) == 1


@pytest.mark.parametrize("seed", range(3))
def test_most_rows_of_a_shuffled_frame_are_found_again(seed: int) -> None:
    first, second = smooth_frames(seed, rows=3000)[2:4]
    order = np.random.default_rng(seed).permutation(len(first.rows))
    kept = order[:-200]  # and 200 die
    partner = match_rows(first, permuted(second, kept))
    position = np.full(len(order), -1)
    position[kept] = np.arange(len(kept))
    paired = partner >= 0
    assert (partner[paired] == position[paired]).mean() > 0.995
    assert paired[kept].mean() > 0.9
    assert len(set(partner[paired].tolist())) == paired.sum()  # no row has two partners


def test_shuffled_frames_give_a_clip_whose_moments_are_the_frames(tmp_path: Path) -> None:
    frames = smooth_frames(7)
    rng = np.random.default_rng(7)
    shuffled = [
        permuted(frame, rng.permutation(len(frame.rows))[: 400 - 5 * i])
        for i, frame in enumerate(frames)
    ]
    path = tmp_path / "clip.onnx"
    exported = source(shuffled).export(path, settings=STATIC)
    assert any("do not correspond" in note for note in exported.notes)
    for number in (0, 3, 7):
        rows = run(path, number / len(frames))["gaussians"]
        alive = rows[rows[:, 3] > 0.4]
        expected = shuffled[number].rows
        assert len(alive) == len(expected)
        nearest = np.linalg.norm(alive[None, :, :3] - expected[:, None, :3], axis=2).min(axis=1)
        assert np.quantile(nearest, 0.99) < 0.05
        assert (rows[rows[:, 3] <= 0.4, 3] < 0.1).all()  # between frames alone, rows fade


def test_frames_without_a_common_gaussian_are_refused(tmp_path: Path) -> None:
    frames = [random_frames(seed, frames=1)[0] for seed in range(6)]
    with pytest.raises(
        GeneratorInvalid, match=r"too few match: 1,1\d\d different Gaussians in the first 4"
    ):
        source(frames).export(tmp_path / "clip.onnx", settings=STATIC)
    assert not list(tmp_path.iterdir())


def test_fewer_bytes_are_a_larger_error(tmp_path: Path) -> None:
    frames = smooth_frames(1)
    sizes = []
    whole = source(frames).export(tmp_path / "whole.onnx", settings=STATIC)
    for share in (0.9, 0.75):
        assert whole.measured is not None
        limit = int(share * sum(whole.measured["table_bytes"].values()))
        result = source(frames, max_bytes=limit).export(tmp_path / "clip.onnx", settings=STATIC)
        assert result.measured is not None
        sizes.append(sum(result.measured["table_bytes"].values()))
        assert sizes[-1] <= limit
    with pytest.raises(ConfigInvalid, match=r"100 bytes are too few: the coarsest tables have \d"):
        source(frames, max_bytes=100).export(tmp_path / "clip.onnx", settings=STATIC)


def test_kinds_of_frames_may_not_differ(tmp_path: Path) -> None:
    frames: list[ConstantRows] = random_frames(2)
    frames[3] = replace(frames[3], color_space="linear")
    with pytest.raises(
        GeneratorInvalid, match=r"3\.ply: color space: linear, expected srgb as in 0"
    ):
        source(frames).export(tmp_path / "clip.onnx", settings=STATIC)
    assert isinstance(source(frames), ClipSource)
