"""State machines: 10,000 random events keep the caps of pool and cache, and ancestors of needs."""

import hashlib
import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from hypothesis.stateful import run_state_machine_as_test as run_machine

from gsgen.tiles.loading.tileset_loader import open_tileset
from gsgen.tiles.selection.tile_tree import TileTree
from gsgen.tiles.streaming.disk_cache import DiskCache
from gsgen.tiles.streaming.residency import ResidentTiles
from support.tiles.journeys import write_town
from support.tiles.request_trees import ancestors

pytestmark = pytest.mark.slow


EVENTS = 10_000
EXAMPLES, STEPS = 250, 50  # most examples take all steps
CAPACITY = 15  # slots
MAX_BYTES = 2_000
_NO_CHECKS = [HealthCheck.too_slow, HealthCheck.data_too_large]


def machine_settings() -> settings:
    return settings(
        max_examples=EXAMPLES,
        stateful_step_count=STEPS,
        deadline=None,
        database=None,
        derandomize=True,
        suppress_health_check=_NO_CHECKS,
    )


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> TileTree:
    return TileTree.of_tileset(open_tileset(write_town(tmp_path_factory.mktemp("town"), depth=3)))


def pool_machine(tree: TileTree, events: list[str]) -> type[RuleBasedStateMachine]:
    """Return a machine of the pool of ``tree`` that notes the name of each event."""
    rows = st.integers(0, len(tree) - 1)
    needs = st.sets(rows, max_size=12) | st.just(set(range(len(tree))))  # all: none may leave

    class PoolMachine(RuleBasedStateMachine):
        """Admits, needs and removes tiles; a naive model says which tiles may leave."""

        def __init__(self) -> None:
            super().__init__()
            self.slots = np.random.default_rng(3).integers(1, 6, len(tree))
            self.pool = ResidentTiles(tree, self.slots, CAPACITY)
            self.there: set[int] = set()
            self.last_use: dict[int, float] = {}
            self.protected: set[int] = set()
            self.time = 0.0

        @rule(needed=needs)
        def frame(self, needed: set[int]) -> None:
            """A camera needs resident tiles, or tiles that are to come."""
            events.append("frame")
            self.time += 1
            self.pool.frame(self.time, np.isin(np.arange(len(tree)), sorted(needed)))
            self.protected = {0}.union(*({row, *ancestors(tree, row)} for row in needed))
            self.last_use.update(dict.fromkeys(self.protected, self.time))

        @rule(tile=rows)
        def admit(self, tile: int) -> None:
            """A tile arrives; those leave that nobody needs, the least useful first."""
            events.append("admit")
            self.time += 1
            evictable = sorted(
                self.there - self.protected,
                key=lambda row: (self.last_use.get(row, -np.inf), -tree.level[row], -row),
            )
            used, leaving_tiles = sum(self.slots[list(self.there)]), []
            if tile not in self.there:
                while used + self.slots[tile] > CAPACITY and evictable:
                    leaving_tiles.append(evictable.pop(0))
                    used -= self.slots[leaving_tiles[-1]]
            is_fitting = tile in self.there or used + self.slots[tile] <= CAPACITY
            victims = self.pool.admit_tile(tile, self.time)
            assert victims == (tuple(leaving_tiles) if is_fitting else None)
            events.extend(["evict"] * len(victims or ()) if is_fitting else ["refuse"])
            assert not self.protected & set(victims or ())
            if is_fitting and tile not in self.there:
                self.there = self.there - set(leaving_tiles) | {tile}
                self.last_use[tile] = self.time

        @precondition(lambda self: self.there)
        @rule(data=st.data())
        def remove(self, data: st.DataObject) -> None:
            """The renderer loses a tile."""
            events.append("remove")
            tile = data.draw(st.sampled_from(sorted(self.there)))
            self.pool.remove(tile)
            self.there.remove(tile)

        @invariant()
        def cap_holds(self) -> None:
            assert self.there == set(np.flatnonzero(self.pool.resident).tolist())
            assert self.pool.used_slots == sum(self.slots[list(self.there)]) <= CAPACITY

        @invariant()
        def ancestors_are_protected(self) -> None:
            marks = np.isin(np.arange(len(tree)), sorted(self.protected))
            np.testing.assert_array_equal(self.pool.with_ancestors(marks)[1:], marks[1:])

    return PoolMachine


def test_the_pool_holds_its_capacity_and_the_ancestors_of_what_is_needed(tree: TileTree) -> None:
    events: list[str] = []
    run_machine(pool_machine(tree, events), settings=machine_settings())
    assert set(events) == {"frame", "admit", "remove", "evict", "refuse"}
    assert sum(event in ("frame", "admit", "remove") for event in events) >= EVENTS


def content_name(data: bytes) -> str:
    return f"t/3/5-{hashlib.sha256(data).hexdigest()[:8]}.glb"


def cache_machine(events: list[str]) -> type[RuleBasedStateMachine]:
    """Return a machine of the disk cache that notes the name of each event."""
    files = [np.random.default_rng(n).bytes(100 + 61 * n) for n in range(12)]
    files.append(bytes(MAX_BYTES + 1))
    numbers = st.integers(0, len(files) - 1)

    class CacheMachine(RuleBasedStateMachine):
        """Stores, reads, damages and opens again; what comes back is what was stored."""

        def __init__(self) -> None:
            super().__init__()
            self.scratch = tempfile.TemporaryDirectory()
            self.folder = Path(self.scratch.name) / "cache"
            self.cache = DiskCache(self.folder, MAX_BYTES)

        def stored(self) -> dict[str, int]:
            if not self.folder.exists():
                return {}
            return {file.name: file.stat().st_size for file in self.folder.iterdir()}

        @rule(number=numbers)
        def put(self, number: int) -> None:
            """A file arrives; the last one stays if it fits at all."""
            events.append("put")
            self.cache.put("http://a", content_name(files[number]), files[number])
            if len(files[number]) <= MAX_BYTES:
                assert self.cache.get("http://a", content_name(files[number])) == files[number]

        @rule(number=numbers)
        def get(self, number: int) -> None:
            """A file comes back whole or not at all."""
            data = self.cache.get("http://a", content_name(files[number]))
            events.append("hit" if data is not None else "miss")
            assert data in (None, files[number])
            assert self.cache.get("http://b", content_name(files[number])) is None

        @precondition(lambda self: self.stored())
        @rule(data=st.data())
        def damage(self, data: st.DataObject) -> None:
            """A stored file loses its end."""
            events.append("damage")
            name = data.draw(st.sampled_from(sorted(self.stored())))
            file = self.folder / name
            file.write_bytes(file.read_bytes()[:-1])
            self.cache = DiskCache(self.folder, MAX_BYTES)

        @rule()
        def open_again(self) -> None:
            """Another process opens the same folder."""
            events.append("open")
            self.cache = DiskCache(self.folder, MAX_BYTES)

        @invariant()
        def cap_holds(self) -> None:
            assert sum(self.stored().values()) == self.cache.total_bytes <= MAX_BYTES

        def teardown(self) -> None:
            self.scratch.cleanup()

    return CacheMachine


def test_the_disk_cache_holds_its_cap_and_returns_whole_files() -> None:
    events: list[str] = []
    run_machine(cache_machine(events), settings=machine_settings())
    assert len(events) >= EVENTS
    assert set(events) == {"put", "hit", "miss", "damage", "open"}
