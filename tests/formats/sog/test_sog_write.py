"""SOG files that gsgen writes: decoded by the slow decoder, by gsgen and by splat-transform."""

import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.cluster.vq import kmeans2

from formats.sog.test_sog import naive_read
from gsgen.formats import NotSupported, Splats, open_splats, read_ply, read_sog, write_sog
from gsgen.formats.shared.morton import grid_order
from gsgen.formats.sog.codebook import make_codebook, nearest_codes
from gsgen.formats.sog.meta import CODEBOOK_SIZE
from gsgen.formats.sog.palette import make_palette, nearest_entries
from gsgen.formats.sog.write import sog_order
from support.splat_files import FIELDS, GOLDENS, assert_near, opacity, scene, turn_between


def ordered(splats: Splats) -> Splats:
    order = sog_order(splats)
    return replace(splats, **{name: getattr(splats, name)[order] for name in FIELDS})


def members(file: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(file) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.mark.parametrize(("count", "degree"), [(1, 0), (7, 1), (300, 2), (5000, 3)])
def test_the_slow_decoder_gets_the_splats_back(tmp_path, count, degree):
    splats = scene(count, degree, seed=count)
    file = tmp_path / "a.sog"
    write_sog(file, splats)
    restored, expected = naive_read(members(file)), ordered(splats)
    assert_near(read_sog(file), restored, position=1e-5, rotation=1e-6)
    stored = [
        np.sign(p) * np.log1p(np.abs(p.astype(float)))
        for p in (restored.position, expected.position)
    ]
    step = np.ptp(stored[1], axis=0) / 65535
    assert (np.abs(stored[0] - stored[1]) <= 0.51 * step + 1e-6).all()
    # A component is off by half of √2/255, and the angle by twice the length of that.
    assert turn_between(restored.rotation, expected.rotation) <= 0.01
    assert np.abs(opacity(restored) - opacity(expected)).max() <= 0.5 / 255 + 1e-6
    spread = np.ptp(expected.log_scale)
    assert np.sqrt(np.mean(np.square(restored.log_scale - expected.log_scale))) <= spread / 256
    if degree:
        error = np.sqrt(np.mean(np.square(restored.sh[:, 1:] - expected.sh[:, 1:])))
        # Up to 1024 splats have an entry each; more have half as many, here of mere noise.
        assert error <= (0.02 if count <= 1024 else 0.5) * expected.sh[:, 1:].std()


def test_the_same_splats_give_the_same_bytes(tmp_path):
    splats = scene(3000, 2)
    for name in ("a.sog", "b.sog"):
        write_sog(tmp_path / name, splats)
    assert (tmp_path / "a.sog").read_bytes() == (tmp_path / "b.sog").read_bytes()


def test_the_files_of_a_sog_lie_beside_its_meta(tmp_path):
    splats = scene(40, 1)
    write_sog(tmp_path / "meta.json", splats)
    write_sog(tmp_path / "a.sog", splats)
    archived = members(tmp_path / "a.sog")
    (tmp_path / "a.sog").unlink()
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == archived
    assert list(archived)[-1] == "meta.json"
    restored = open_splats(tmp_path / "meta.json")
    assert isinstance(restored, Splats)
    assert restored.degree == 1


@pytest.mark.parametrize(
    ("key", "value", "antialiased"),
    [("model", "antialiased", True), ("antialias", True, True), ("model", "default", False)],
)
def test_the_tag_of_antialiased_splats_is_read(tmp_path, key, value, antialiased):
    write_sog(tmp_path / "meta.json", scene(5, 0))
    meta = json.loads((tmp_path / "meta.json").read_text())
    assert "model" not in meta
    (tmp_path / "meta.json").write_text(json.dumps(meta | {key: value}))
    assert read_sog(tmp_path / "meta.json").antialiased is antialiased


def test_antialiased_splats_stay_so(tmp_path):
    write_sog(tmp_path / "a.sog", scene(5, 0, antialiased=True))
    assert json.loads(members(tmp_path / "a.sog")["meta.json"])["model"] == "antialiased"
    assert read_sog(tmp_path / "a.sog").antialiased


def test_ends_of_the_ranges_are_kept(tmp_path):
    original = scene(4, 0)
    splats = replace(
        original,
        position=np.float32([[1, 2, -1e30], [1, -2, 0], [1, 0, 1e30], [1, 0, 3]]),
        log_scale=np.float32([[-np.inf, -3, -4], [-5, -np.inf, -30], [1, 2, 3], [0, 0, 0]]),
        logit_opacity=np.float32([np.inf, -np.inf, 0, 1]),
    )
    write_sog(tmp_path / "a.sog", splats)
    restored, expected = read_sog(tmp_path / "a.sog"), ordered(splats)
    np.testing.assert_array_equal(restored.logit_opacity[[0, 1]].shape, (2,))
    assert (restored.position[:, 0] == 1).all()
    assert np.abs(opacity(restored) - opacity(expected)).max() <= 0.002
    is_flat = np.isneginf(expected.log_scale)
    assert (restored.log_scale[is_flat] == -30).all()
    np.testing.assert_allclose(
        restored.log_scale[~is_flat], expected.log_scale[~is_flat], rtol=1e-6
    )
    write_sog(
        tmp_path / "flat.sog", replace(original, log_scale=np.full((4, 3), -np.inf, np.float32))
    )
    assert (read_sog(tmp_path / "flat.sog").log_scale == -20).all()


def test_harmonics_of_degree_4_are_refused(tmp_path):
    with pytest.raises(
        NotSupported, match="the splats have SH degree 4\nexpected degree 3 or less"
    ):
        write_sog(tmp_path / "a.sog", scene(3, 4))
    assert not list(tmp_path.iterdir())


def test_splat_transform_reads_our_file_alike():
    here, reference = (read_sog(GOLDENS / "ours.sog"), read_ply(GOLDENS / "ours.sog.decoded.ply"))
    assert_near(here, reference, position=1e-6, opacities=1e-5)


def test_the_file_that_splat_transform_read_is_still_written(tmp_path):
    source = read_ply(GOLDENS / "scene.ply")
    write_sog(tmp_path / "a.sog", source)
    assert_near(read_sog(tmp_path / "a.sog"), read_sog(GOLDENS / "ours.sog"), opacities=0)


def optimal_error(values: np.ndarray, size: int) -> float:
    """The least squared error of ``size`` numbers, by dynamic programming over sorted values."""
    ascending = np.sort(values)
    first, second = (np.append(0, np.cumsum(ascending**power)) for power in (1, 2))
    count = len(values)
    start, end = np.meshgrid(np.arange(count), np.arange(1, count + 1), indexing="ij")
    with np.errstate(divide="ignore", invalid="ignore"):
        sums = first[end] - first[start]
        variance_in_range = second[end] - second[start] - sums**2 / (end - start)
    variance_in_range[end <= start] = np.inf
    cost = np.append(0, np.full(count, np.inf))
    for _ in range(size):
        cost = np.append(0, (cost[:-1, None] + variance_in_range).min(axis=0))
    return float(cost[-1])


@pytest.mark.parametrize("seed", range(3))
def test_the_codebook_is_nearly_the_best_one(seed, monkeypatch):
    monkeypatch.setattr("gsgen.formats.sog.codebook.CODEBOOK_SIZE", 16)
    values = np.random.default_rng(seed).standard_normal(600).astype(np.float32)
    book = make_codebook(values)
    assert len(book) == 16
    error = np.square(values[:, None] - book).min(axis=1).sum()
    assert error <= 1.15 * optimal_error(values.astype(float), 16)


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 2000), tail=st.booleans())
def test_every_value_gets_the_nearest_code(seed, count, tail):
    rng = np.random.default_rng(seed)
    values = (rng.standard_cauchy(count) if tail else rng.standard_normal(count)).astype(np.float32)
    book = make_codebook(values)
    assert book.shape == (CODEBOOK_SIZE,)
    assert (np.diff(book) >= 0).all()
    distance = np.abs(values[:, None].astype(float) - book)
    chosen = np.abs(values - book[nearest_codes(values, book)].astype(float))
    np.testing.assert_allclose(chosen, distance.min(axis=1), rtol=1e-6, atol=0)


def test_few_values_are_kept_exactly():
    values = np.float32([3, -1, 3, 7])
    book = make_codebook(values)
    np.testing.assert_array_equal(book[nearest_codes(values, book)], values)


def clustered(count: int, width: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    centres = rng.standard_normal((50, width))
    return (centres[rng.integers(0, 50, count)] + 0.3 * rng.standard_normal((count, width))).astype(
        np.float32
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_palette_is_within_a_twentieth_of_that_of_another_library(seed):
    values = clustered(4000, 9, seed)
    palette = make_palette(values, 256)
    assert palette.shape == (256, 9)
    ours = np.square(values - palette[nearest_entries(values, palette)]).mean()
    entries, labels = kmeans2(values.astype(float), 256, iter=20, minit="points", rng=seed)
    assert ours <= 1.05 * np.square(values - entries[labels]).mean()


def test_blocks_find_nearly_always_the_nearest_entry():
    values = clustered(5000, 24, 4)
    palette = make_palette(values, 1024)
    distance = np.square(values[:, None, :4] - palette[None, :, :4]).sum(axis=2)
    for start in range(4, 24, 4):
        part = slice(start, start + 4)
        distance += np.square(values[:, None, part] - palette[None, :, part]).sum(axis=2)
    chosen = distance[np.arange(5000), nearest_entries(values, palette)]
    assert chosen.mean() <= 1.01 * distance.min(axis=1).mean()


@pytest.mark.parametrize("values", [np.zeros((50, 9)), np.tile(np.eye(3, 9), (20, 1))])
def test_a_palette_has_no_more_entries_than_there_are_values(values):
    palette = make_palette(values.astype(np.float32), 32)
    distinct = len(np.unique(values, axis=0))
    assert len(palette) == distinct
    np.testing.assert_array_equal(
        palette[nearest_entries(values.astype(np.float32), palette)], values
    )


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), bits=st.integers(1, 21))
def test_rows_follow_mortons_curve(seed, bits):
    cells = np.random.default_rng(seed).integers(0, 1 << bits, (40, 3)).astype(np.uint32)

    def code(cell: np.ndarray) -> int:
        digits = (f"{int(number):021b}" for number in cell)
        return int("".join("".join(digit_triple) for digit_triple in zip(*digits, strict=True)), 2)

    expected = sorted(range(40), key=lambda row: code(cells[row]))
    np.testing.assert_array_equal(grid_order(cells), expected)
