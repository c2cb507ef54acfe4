"""Evictions: 10,000 random events hold the capacity, and what is needed keeps its ancestors."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gsgen.tiles.loading.tileset_loader import open_tileset
from gsgen.tiles.selection.cut import TileCut
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.streaming.disk_cache import DiskCache, default_cache_folder
from gsgen.tiles.streaming.drawing import TileFades, drawable_tiles
from gsgen.tiles.streaming.residency import ResidentTiles
from support.tiles.journeys import write_town
from support.tiles.request_trees import ancestors


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> TileTree:
    return TileTree.of_tileset(open_tileset(write_town(tmp_path_factory.mktemp("town"), depth=3)))


def random_cut(rng: np.random.Generator, tree: TileTree) -> TileCut:
    refined = (rng.uniform(size=len(tree)) < 0.6) & ~tree.is_leaf
    visible_mask = rng.uniform(size=len(tree)) < 0.8
    visible_mask[0] = True
    for rows in tree.rows_of_level[1:]:
        above = tree.parent[rows]
        visible_mask[rows] &= visible_mask[above] & refined[above]
    return TileCut(visible_mask, visible_mask & ~refined, np.zeros(len(tree)))


def test_ten_thousand_events_hold_the_capacity_and_the_ancestors(tree: TileTree) -> None:
    rng = np.random.default_rng(0)
    slots = rng.integers(1, 6, len(tree))
    capacity = 40
    pool = ResidentTiles(tree, slots, capacity)
    present: set[int] = set()
    needed_rows: list[int] = []
    evictions = refusals = 0
    for event in range(10_000):
        if event % 7 == 0:
            needed_rows = rng.permutation(sorted(present))[: rng.integers(0, 20)].tolist()
            needed_tiles = np.isin(np.arange(len(tree)), needed_rows)
            pool.frame(float(event), needed_tiles)
        tile = int(rng.integers(len(tree)))
        victims = pool.admit_tile(tile, float(event))
        if victims is None:
            refusals += 1
        else:
            evictions += len(victims)
            assert len(set(victims)) == len(victims)
            assert tile not in victims
            present = (present - set(victims)) | {tile}
        assert present == set(np.flatnonzero(pool.resident).tolist())
        assert pool.used_slots == slots[sorted(present)].sum() <= capacity
        protected = {0}.union(*({row, *ancestors(tree, row)} for row in needed_rows))
        assert not protected & set(victims or ())
    assert evictions > 1000
    assert refusals > 0


def test_the_least_recently_used_and_finest_leave_first(tree: TileTree) -> None:
    pool = ResidentTiles(tree, np.ones(len(tree), np.int64), 4)
    none_protected = np.zeros(len(tree), bool)
    coarse = int(tree.rows_of_level[1][0])
    fine = int(tree.rows_of_level[3][0])
    finest_tile = int(tree.rows_of_level[3][-1])
    for tile, time in ((0, 0.0), (coarse, 1.0), (fine, 1.0), (finest_tile, 2.0)):
        assert pool.admit_tile(tile, time) == ()
    pool.frame(3.0, none_protected)
    new = int(tree.rows_of_level[2][0])
    assert pool.admit_tile(new, 3.0) == (fine,)
    pool.frame(4.0, none_protected)
    assert pool.admit_tile(fine, 4.0) == (coarse,)
    with_slots = ResidentTiles(tree, np.full(len(tree), 5), 4)
    assert with_slots.admit_tile(coarse, 0.0) is None


def drawn_by_a_walk(tree: TileTree, cut: TileCut, resident: np.ndarray) -> set[int]:
    """What to draw, by recursion from its definition."""
    children: dict[int, list[int]] = {row: [] for row in range(len(tree))}
    for row in range(1, len(tree)):
        children[int(tree.parent[row])].append(row)

    def below(row: int) -> list[int]:
        return [child for child in children[row] if cut.seen[child]]

    def shown(row: int) -> bool:
        replaced = not cut.selected[row] and below(row) and not tree.is_additive[row]
        return bool(resident[row]) or bool(replaced and all(map(shown, below(row))))

    def draw(row: int) -> set[int]:
        here = {row} if resident[row] else set()
        if cut.selected[row]:
            return here
        parts = set().union(*(draw(child) for child in below(row)))
        if tree.is_additive[row]:
            return here | parts
        if below(row) and all(map(shown, below(row))):
            return parts
        return here or parts

    return draw(0) if cut.seen[0] else set()


def test_drawable_tiles_equal_those_of_a_recursive_walk(tree: TileTree) -> None:
    rng = np.random.default_rng(1)
    for _ in range(300):
        cut = random_cut(rng, tree)
        resident = rng.uniform(size=len(tree)) < rng.choice([0.3, 0.7, 0.95, 1.0])
        drawn = drawable_tiles(tree, cut, resident)
        assert set(np.flatnonzero(drawn).tolist()) == drawn_by_a_walk(tree, cut, resident)
        if resident[cut.selected].all():
            descendants = np.bincount(tree.parent[1:][cut.seen[1:]], minlength=len(tree))
            shown = cut.selected | (cut.seen & (descendants == 0) & resident)
            np.testing.assert_array_equal(drawn, shown)


def test_a_replacement_fades_and_a_tile_that_comes_into_view_does_not(tree: TileTree) -> None:
    fades = TileFades(tree, 0.25)
    visible_mask = np.ones(len(tree), bool)
    drawn = np.zeros(len(tree), bool)
    drawn[0] = True
    fades.frame(0.0, drawn, visible_mask)
    assert fades.values[0] == 1
    children = np.flatnonzero(tree.parent == 0)
    replaced = np.zeros(len(tree), bool)
    replaced[children] = True
    values = []
    for time in np.arange(1, 8) * 0.05:
        fades.frame(time, replaced, visible_mask)
        sums = fades.values[children] + fades.values[0]
        np.testing.assert_allclose(sums, 1)
        values.append(float(fades.values[0]))
    np.testing.assert_allclose(values, [0.8, 0.6, 0.4, 0.2, 0, 0, 0], atol=1e-9)
    assert fades.is_settled
    # One leaves the view, and comes back: at once, both times.
    removed_tiles, hidden = replaced.copy(), visible_mask.copy()
    removed_tiles[children[0]] = hidden[children[0]] = False
    fades.frame(0.4, removed_tiles, hidden)
    assert fades.values[children[0]] == 0
    fades.frame(0.41, replaced, visible_mask)
    assert fades.values[children[0]] == 1
    # The change back, interrupted half way.
    fades.frame(0.5, drawn, visible_mask)
    middle = fades.values[0]
    assert 0 < middle < 1
    fades.frame(0.55, replaced, visible_mask)
    assert fades.values[0] < middle
    still = TileFades(tree, 0.0)
    still.frame(0.0, drawn, visible_mask)
    still.frame(0.0, replaced, visible_mask)
    assert still.is_settled
    assert still.values[0] == 0


def content_name(data: bytes) -> str:
    import hashlib

    return f"t/3/5-{hashlib.sha256(data).hexdigest()[:8]}.glb"


def test_the_disk_cache_holds_its_cap_and_gives_back_the_bytes(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    cache = DiskCache(tmp_path / "cache", 50_000)
    files = [rng.bytes(int(size)) for size in rng.integers(1, 9000, 60)]
    hit_count = 0
    for _ in range(2000):
        data = files[int(rng.integers(60))]
        cached = cache.get("http://a", content_name(data))
        assert cached in (None, data)
        hit_count += cached is not None
        if cached is None:
            cache.put("http://a", content_name(data), data)
        total = sum(f.stat().st_size for f in (tmp_path / "cache").iterdir())
        assert total == cache.total_bytes <= 50_000
    assert 100 < hit_count < 1900
    assert DiskCache(tmp_path / "cache", 50_000).total_bytes == cache.total_bytes
    assert cache.get("http://b", content_name(files[0])) is None


_WRITER = """
import sys
from pathlib import Path
import numpy as np
from gsgen.tiles.streaming.disk_cache import DiskCache

folder, seed = Path(sys.argv[1]), int(sys.argv[2])
cache, rng, most = DiskCache(folder, 50_000), np.random.default_rng(seed), 0
for number in range(400):
    data = rng.bytes(int(rng.integers(1, 9000)))
    digest = __import__("hashlib").sha256(data).hexdigest()
    cache.put("http://a", f"{seed}-{number}.onnx", data, digest)
    most = max(most, cache.total_bytes)
assert cache.get("http://a", f"{seed}-399.onnx", digest) in (None, data)
print(most)
"""


def test_several_processes_keep_one_cap(tmp_path: Path) -> None:
    words = [sys.executable, "-c", _WRITER, str(tmp_path / "cache")]
    writers = [
        subprocess.Popen([*words, str(seed)], stdout=subprocess.PIPE, text=True)
        for seed in range(3)
    ]
    most = [int(writer.communicate()[0]) for writer in writers]
    assert [writer.returncode for writer in writers] == [0, 0, 0]
    # A file that is being written counts, and one more that a scan meets while it is renamed.
    assert max(most) <= 50_000 + 9000
    total = sum(file.stat().st_size for file in (tmp_path / "cache").iterdir())
    assert 40_000 < total <= 50_000


def test_a_file_that_changed_on_disk_or_has_no_digest_is_not_given(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 1000)
    cache.put("a", "tileset.json", b"{}")
    cache.put("a", "t/0/0-00000000.glb", b"not that digest")
    assert list(tmp_path.iterdir()) == []
    cache.put("a", content_name(b"data"), b"data")
    (file,) = tmp_path.iterdir()
    file.write_bytes(b"dat")
    assert cache.get("a", content_name(b"data")) is None
    assert list(tmp_path.iterdir()) == []
    cache.put("a", content_name(b"x" * 2000), b"x" * 2000)
    assert list(tmp_path.iterdir()) == []


def test_a_version_is_given_with_its_validator_unless_it_is_damaged(tmp_path: Path) -> None:
    cache = DiskCache(tmp_path, 1000)
    cache.put_version("a", "0.webp", "", b"of a server that tells no version")
    cache.put_version("a", "0.webp", '"1"', b"x" * 2000)
    assert list(tmp_path.iterdir()) == []
    for validator, data in (('"1"', b"one\ntwo"), ("Mon, 30 Nov 2026 14:00:00 GMT", b"")):
        cache.put_version("a", "0.webp", validator, data)
        assert cache.get_version("a", "0.webp") == (validator, data)
    assert cache.get_version("b", "0.webp") == ("", b"")
    (file,) = tmp_path.iterdir()
    for damaged in (b"", b"\xff", file.read_bytes().replace(b"14:00", b"15:00"), b" \n"):
        file.write_bytes(damaged)
        assert cache.get_version("a", "0.webp") == ("", b"")


def test_the_cache_lies_where_the_user_wants(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert default_cache_folder() == Path("/somewhere/gsgen/tiles")
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", "/home/user")
    assert default_cache_folder() == Path("/home/user/.cache/gsgen/tiles")
