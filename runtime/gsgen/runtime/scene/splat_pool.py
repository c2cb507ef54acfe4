"""A splat pool: fixed GPU memory, in slots, for streamed tiles that come and go.

A pool has as many rows from its first frame to its last, so that arrivals and evictions change
neither buffers nor the frame plan. A tile takes slots anywhere; what is drawn of a slot stands in
the slot table, which is written every frame.
"""

__all__ = [
    "REACH_SIGMAS",
    "SLOT_ROWS",
    "PooledSplatSet",
    "SlotWrite",
    "SplatPool",
    "pool_row_bytes",
]

import heapq
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Final, Literal, final

import numpy as np
from jaxtyping import Float, Float32, Float64, UInt32

from gsgen.contract.spec import layout
from gsgen.contract.spec.spherical_harmonics import degree_of
from gsgen.runtime.errors import CapacityExceeded, SceneInvalid
from gsgen.runtime.scene.transforms import identity, require_affine

SLOT_ROWS: Final = 4096
"""Rows of a tile slot: few, so that half a slot is a small waste and slots can be culled."""

_VECTOR_BYTES: Final = 16  # bytes: shaders read colours in whole vectors

REACH_SIGMAS: Final = 3.5
"""More standard deviations than a splat is drawn in: √(2 ln 255) = 3.33."""


def pool_row_bytes(channels: int) -> int:
    """Return the most bytes that a Gaussian of a splat pool takes on the GPU."""
    return 4 * layout.ROW_LENGTH + -(-4 * channels // _VECTOR_BYTES) * _VECTOR_BYTES


@final
@dataclass(frozen=True, slots=True, eq=False)
class SlotWrite:
    """Gaussians of a streamed tile that wait to be copied into the splat pool on the GPU."""

    first: int  # row of the pool
    rows: Float32[np.ndarray, "n 10"]
    appearance: Float32[np.ndarray, "n c"]


@final
class SplatPool:
    """GPU memory for streamed tiles of Gaussians, divided into slots, and the tiles to draw.

    Args:
        rows: Number of rows, rounded up to whole slots.
        channels: SH coefficients of a Gaussian, times three.
        slot_rows: Rows of a slot, a multiple of 64.

    Attributes:
        live: Number of rows in each slot that hold Gaussians.
        fade: Factor on the opacity of each slot in the next frame; 0 for those that are not drawn.
        origin: What the positions in each slot are relative to.
        low: Least corner of the box around the splats of each slot, relative to ``origin``.
        high: Greatest corner of that box.

    Raises:
        SceneInvalid: No rows, no such number of channels, or slots of another size.
    """

    def __init__(self, rows: int, channels: int, *, slot_rows: int = SLOT_ROWS) -> None:
        if rows < 1 or slot_rows < 64 or slot_rows % 64:
            raise SceneInvalid(
                f"the splat pool has {rows} rows in slots (tile parts) of {slot_rows} rows, "
                "expected at least one row, and slots of a multiple of 64 rows",
                where="pool",
            )
        if channels not in layout.APPEARANCE_CHANNELS["sh"]:
            allowed_channels = ", ".join(map(str, layout.APPEARANCE_CHANNELS["sh"]))
            raise SceneInvalid(
                f"the splat pool has {channels} colour channels, expected one of {allowed_channels}",
                where="pool",
            )
        self.slot_rows, self.channels = slot_rows, channels
        self.slots = -(-rows // slot_rows)
        self.live: UInt32[np.ndarray, " s"] = np.zeros(self.slots, np.uint32)
        self.fade: Float32[np.ndarray, " s"] = np.zeros(self.slots, np.float32)
        self.origin: Float64[np.ndarray, "s 3"] = np.zeros((self.slots, 3))
        self.low: Float32[np.ndarray, "s 3"] = np.zeros((self.slots, 3), np.float32)
        self.high: Float32[np.ndarray, "s 3"] = np.zeros((self.slots, 3), np.float32)
        self._free_slots = list(range(self.slots))  # a heap: the lowest slot is taken first
        self._slots_by_tile: dict[int, list[int]] = {}
        self._slot_writes: list[SlotWrite] = []

    @property
    def degree(self) -> int:
        """The SH degree of all streamed tiles' colours in a splat pool (GPU memory)."""
        return degree_of(self.channels // 3)

    @property
    def free_slots(self) -> int:
        """The number of slots of the splat pool (for streamed tiles) that no tile occupies."""
        return len(self._free_slots)

    @property
    def tiles(self) -> tuple[int, ...]:
        """The keys of all streamed tiles in the splat pool, in ascending order."""
        return tuple(sorted(self._slots_by_tile))

    def __len__(self) -> int:
        return self.slots * self.slot_rows

    def insert(
        self,
        tile: int,
        rows: Float32[np.ndarray, "n 10"],
        appearance: Float32[np.ndarray, "n c"],
        origin: Float[np.ndarray, "3"],
        *,
        reserved_rows: int = 0,
    ) -> None:
        """Assign splat pool slots to a tile, whose Gaussians are uploaded before the next frame.

        Args:
            tile: Key of the tile, which is not in the pool.
            rows: ``x y z opacity xx xy xz yy yz zz``, with positions relative to ``origin``.
            appearance: SH coefficients, as many as the pool has channels.
            origin: In the space of the pool, float64.
            reserved_rows: Rows for which the tile gets slots, if more than it has now; see
                :meth:`rewrite`.

        Raises:
            CapacityExceeded: The free slots do not suffice.
            SceneInvalid: The tile is there already, or the arrays have other shapes.
        """
        if tile in self._slots_by_tile:
            raise SceneInvalid("the tile is in the splat pool already", where=f"tile {tile}")
        self._require_shapes(tile, rows, appearance)
        needed_slots = -(-max(len(rows), reserved_rows) // self.slot_rows)
        if needed_slots > len(self._free_slots):
            raise CapacityExceeded(
                f"the tile needs {needed_slots} slots, but only {len(self._free_slots)} of {self.slots} are free",
                where=f"tile {tile}",
                hint="Evict tiles first, or make the pool larger.",
            )
        slots = [heapq.heappop(self._free_slots) for _ in range(needed_slots)]
        self._slots_by_tile[tile] = slots
        self._write(slots, rows, appearance, origin)

    def rewrite(
        self,
        tile: int,
        rows: Float32[np.ndarray, "n 10"],
        appearance: Float32[np.ndarray, "n c"],
        origin: Float[np.ndarray, "3"],
    ) -> None:
        """Replace the Gaussians of a tile in the splat pool on the GPU; arguments as in ``insert``.

        Raises:
            CapacityExceeded: The slots of the tile do not suffice.
            SceneInvalid: The tile is not in the pool, or the arrays have other shapes.
        """
        slots = self._slots_held_by_tile(tile)
        self._require_shapes(tile, rows, appearance)
        if len(rows) > len(slots) * self.slot_rows:
            raise CapacityExceeded(
                f"the tile has {len(rows):,} rows, but its slots hold {len(slots) * self.slot_rows:,}",
                where=f"tile {tile}",
                hint="Reserve rows when the tile is inserted.",
            )
        self._overwrite_slots(slots, rows, appearance, origin)

    def extend(
        self,
        tile: int,
        rows: Float32[np.ndarray, "n 10"],
        appearance: Float32[np.ndarray, "n c"],
        origin: Float[np.ndarray, "3"],
        *,
        first_row: int,
    ) -> None:
        """Write some of a tile's Gaussians in the splat pool, from a slot's first row on.

        Raises:
            SceneInvalid: The tile is not in the pool, or the arrays have other shapes.
        """
        slots = self._slots_held_by_tile(tile)[first_row // self.slot_rows :]
        self._require_shapes(tile, rows, appearance)
        if first_row % self.slot_rows or len(rows) > len(slots) * self.slot_rows:
            raise SceneInvalid(
                f"rows {first_row} to {first_row + len(rows)} do not begin a slot of "
                f"{self.slot_rows:,}, or exceed the tile's slots",
                where=f"tile {tile}",
            )
        slots = slots[: -(-len(rows) // self.slot_rows)]
        self._overwrite_slots(slots, rows, appearance, origin)

    def stage(
        self,
        tile: int,
        rows: Float32[np.ndarray, "n 10"],
        appearance: Float32[np.ndarray, "n c"],
        origin: Float[np.ndarray, "3"],
        *,
        first_row: int,
        count: int,
    ) -> None:
        """Write part of a tile's new Gaussians to spare slots; draw them when all are written.

        The tile has twice the slots that it needs; those of the second half are not drawn. The
        halves change places with the last row.

        Args:
            tile: Key of the tile.
            rows: Packed Gaussians, as for :meth:`insert`.
            appearance: SH coefficients of these rows.
            origin: In the space of the pool, float64.
            first_row: Of these rows; it begins a slot.
            count: Number of the next Gaussians, all parts together.

        Raises:
            SceneInvalid: The tile is not in the pool, the rows do not fit the half of its slots,
                or the arrays have other shapes.
        """
        slots = self._slots_held_by_tile(tile)
        self._require_shapes(tile, rows, appearance)
        half_slot_count, end_row = len(slots) // 2, first_row + len(rows)
        drawn, staged_slots = slots[:half_slot_count], slots[half_slot_count:]
        has_room = (
            end_row <= count <= half_slot_count * self.slot_rows
            and not self.live[staged_slots].any()
        )
        if first_row % self.slot_rows or not has_room:
            raise SceneInvalid(
                f"rows {first_row} to {end_row} of {count} do not begin a slot of "
                f"{self.slot_rows:,}, or exceed the second half of the tile's {len(slots)} slots",
                where=f"tile {tile}",
            )
        part = staged_slots[first_row // self.slot_rows : -(-end_row // self.slot_rows)]
        self._overwrite_slots(part, rows, appearance, origin)
        self.live[staged_slots] = 0
        if end_row == count:
            slot_starts = self.slot_rows * np.arange(len(staged_slots))
            self.live[drawn] = 0
            self.live[staged_slots] = np.clip(count - slot_starts, 0, self.slot_rows)
            self._slots_by_tile[tile] = staged_slots + drawn

    def _require_shapes(self, tile: int, rows: np.ndarray, appearance: np.ndarray) -> None:
        if rows.shape != (len(rows), layout.ROW_LENGTH) or appearance.shape != (
            len(rows),
            self.channels,
        ):
            raise SceneInvalid(
                f"has rows {list(rows.shape)} and appearance {list(appearance.shape)}, expected "
                f"[N, {layout.ROW_LENGTH}] and [N, {self.channels}]",
                where=f"tile {tile}",
            )

    def _write(
        self,
        slots: list[int],
        rows: Float32[np.ndarray, "n 10"],
        appearance: Float32[np.ndarray, "n c"],
        origin: Float[np.ndarray, "3"],
    ) -> None:
        """Record a tile's slots (row ranges) in the splat pool, and queue its upload to the GPU."""
        reach = REACH_SIGMAS * np.sqrt(np.maximum(rows[:, [4, 7, 9]], 0))
        box_lows, box_highs = rows[:, :3] - reach, rows[:, :3] + reach
        for index, slot in enumerate(slots):
            part = slice(index * self.slot_rows, (index + 1) * self.slot_rows)
            self.live[slot] = len(rows[part])
            self.origin[slot] = origin
            if not self.live[slot]:  # a reserved slot without rows
                continue
            self.low[slot], self.high[slot] = (
                box_lows[part].min(axis=0),
                box_highs[part].max(axis=0),
            )
            first = slot * self.slot_rows
            self._slot_writes.append(SlotWrite(first, rows[part], appearance[part]))

    def _overwrite_slots(
        self,
        slots: list[int],
        rows: Float32[np.ndarray, "n 10"],
        appearance: Float32[np.ndarray, "n c"],
        origin: Float[np.ndarray, "3"],
    ) -> None:
        """Write rows into splat pool slots, and drop queued writes to the same slots."""
        self._drop_slot_writes(slots)
        self._write(slots, rows, appearance, origin)

    def _drop_slot_writes(self, slots: list[int]) -> None:
        first_rows = {slot * self.slot_rows for slot in slots}
        self._slot_writes = [write for write in self._slot_writes if write.first not in first_rows]

    def _slots_held_by_tile(self, tile: int) -> list[int]:
        if tile not in self._slots_by_tile:
            raise SceneInvalid("the tile is not in the splat pool", where=f"tile {tile}")
        return self._slots_by_tile[tile]

    def evict(self, tile: int) -> None:
        """Free the slots that a tile occupies in the splat pool (GPU memory for streamed tiles).

        Raises:
            SceneInvalid: The tile is not in the pool.
        """
        slots = self._slots_held_by_tile(tile)
        del self._slots_by_tile[tile]
        self._drop_slot_writes(slots)
        for slot in slots:
            self.live[slot] = self.fade[slot] = 0
            heapq.heappush(self._free_slots, slot)

    def draw(self, opacity_factor_by_tile: Mapping[int, float]) -> None:
        """Set the tiles of the splat pool that the next frames draw, each with an opacity factor.

        Raises:
            SceneInvalid: A tile is not in the pool.
        """
        self.fade[:] = 0
        for tile, tile_opacity_factor in opacity_factor_by_tile.items():
            self.fade[self._slots_held_by_tile(tile)] = tile_opacity_factor

    def take_writes(self) -> list[SlotWrite]:
        """Return and clear the splat pool's queue of Gaussians that a renderer has to upload."""
        writes, self._slot_writes = self._slot_writes, []
        return writes

    def locate(self, row: int) -> tuple[int, int]:
        """Return the key of the tile, and the row in the tile, of a row of the splat pool.

        Raises:
            IndexError: No tile holds the row.
        """
        slot, offset = divmod(row, self.slot_rows)
        for tile, slots in self._slots_by_tile.items():
            if slot in slots and offset < self.live[slot]:
                return tile, slots.index(slot) * self.slot_rows + offset
        raise IndexError(f"no tile holds row {row} of the splat pool")


@final
@dataclass(frozen=True, slots=True, eq=False)
class PooledSplatSet:
    """A splat pool (GPU memory of streamed tiles) with a transform and drawing settings.

    Raises:
        SceneInvalid: The transform or a number cannot be used.
    """

    pool: SplatPool
    transform: Float[np.ndarray, "4 4"] = field(default_factory=identity)
    _: KW_ONLY
    opacity_scale: float = 1.0
    degree: int | None = None
    antialias: Literal["classic", "mip"] = "classic"

    def __post_init__(self) -> None:
        matrix = np.array(self.transform, np.float64)
        object.__setattr__(self, "transform", matrix)
        require_affine(matrix)
        if not (np.isfinite(self.opacity_scale) and self.opacity_scale >= 0):
            message = f"is {self.opacity_scale}, expected a finite number ≥ 0"
            raise SceneInvalid(message, where="opacity_scale")
