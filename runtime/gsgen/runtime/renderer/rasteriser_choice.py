"""Chooses a GPU's fastest rasteriser and image-tile size: each draws one test frame.

Compute tiles stop at finished pixels, but first list the splats of each tile. The hardware's quads
need no list, but blend every fragment. Which is faster depends on how fast a GPU's fixed-function
units blend 32-bit floats. Large tiles have fewer pairs to sort, small ones fewer pixels that a pair
does not touch. That varies more than tenfold between GPUs of equal arithmetic (those of
data centres have few such units), and no limit or feature of the device reports it.
"""

__all__ = [
    "RasteriserOption",
    "Timings",
    "choose",
    "chosen_sort_config",
    "describe_choice",
    "measure_options",
]

import json
import os
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Final, Literal, cast, final

import numpy as np

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.atomic_files import atomic_write
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.gpu.gpu_timer import StageClock
from gsgen.runtime.gpu.splat_residency import Residency
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.shader import LARGE_TILE, TILE
from gsgen.runtime.kernels.sort.sort import SortConfig, sort_config_for
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.renderer.placed_pages import PlacedPage
from gsgen.runtime.renderer.plan_options import ImageSpec, Rasteriser, RasterMethod
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import SplatSet
from gsgen.runtime.scene.splat_data import SplatData

RasteriserOption = Literal["auto", "tiles", "quads"]

_SAMPLE_GAUSSIAN_COUNT: Final = 1 << 17
_IMAGE_SIZE: Final = (1280, 720)
_FIRST_PAIR_CAPACITY: Final = 1 << 16  # first capacity
_WARM_UP_FRAMES: Final = 2  # frames before the measurement: drivers compile, clocks rise
_MEASURED_FRAMES: Final = 7
_QUAD_TIME_FACTOR: Final = (
    0.8  # quads must be this much faster: tiles are more exact, and stop early
)
_TILE_STAGES: Final = ("bin", "group", "blend")  # the stages that quads replace
_BLACK_RGB: Final = np.zeros(3)
_PROBE_VERSION: Final = 3  # of the measurement; a new version invalidates cached timings
_MAX_CACHE_BYTES: Final = 1 << 16  # of the cache file


@final
@dataclass(frozen=True, slots=True)
class Timings:
    """Seconds that a GPU takes to draw: with compute tiles of two sizes, and hardware quads.

    Attributes:
        tiles: Seconds of listing pairs, sorting them by tile and blending, with LARGE_TILE.
        quads: Seconds of drawing quads.
        small_tiles: Those of ``tiles``, with TILE.
    """

    tiles: float
    quads: float
    small_tiles: float

    @property
    def fastest_rasteriser(self) -> Rasteriser:
        """The rasteriser to use on a GPU: hardware quads only if they are clearly faster."""
        return (
            "quads"
            if self.quads < _QUAD_TIME_FACTOR * min(self.tiles, self.small_tiles)
            else "tiles"
        )

    @property
    def tile(self) -> int:
        """The edge of the image tiles to use on a GPU, in pixels."""
        return TILE if self.small_tiles < self.tiles else LARGE_TILE


MeasureTimings = Callable[[Device, Kernels], Timings]


def choose(device: Device, kernels: Kernels, measure: MeasureTimings | None = None) -> Rasteriser:
    """Return the faster rasteriser of a device, measured on the first call.

    Timings are cached in the process and, by adapter and driver, in ``rasterisers.json`` in
    the user's cache folder (``~/.cache/gsgen`` on Linux). With the environment variable
    ``GSGEN_NO_CACHE`` set, no file is read or written.

    Args:
        device: The device. Software drivers, and devices that cannot blend 32-bit floats,
            use tiles without a measurement.
        kernels: Kernels of the device.
        measure: Function that measures; :func:`measure_options` by default.
    """
    if device.software or not device.blends_floats:
        return "tiles"
    key = _device_key(device)
    if key not in _timings_by_device:
        cached_choice = _read_cache().get(key)
        if cached_choice is None:
            cached_choice = (measure or measure_options)(device, kernels)
            _write_cache(_read_cache() | {key: cached_choice})
        _timings_by_device[key] = cached_choice
    return _timings_by_device[key].fastest_rasteriser


def chosen_sort_config(device: Device) -> SortConfig:
    """Return a device's sort settings, with the tile size that :func:`choose` measured, if any."""
    sort_config, timings = sort_config_for(device), _timings_by_device.get(_device_key(device))
    if device.software or timings is None:
        return sort_config
    return replace(sort_config, tile=timings.tile)


def describe_choice(device: Device) -> str:
    """Return a line on a device's kernels and rasteriser; may first measure the rasterisers."""
    if not device.software and device.blends_floats:
        choose(device, Kernels(device))
    sort_config = chosen_sort_config(device)
    kind = "CPUs, which is where the driver runs" if device.software else "GPUs"
    text = f"kernels for {kind}; tiles of {sort_config.tile} pixels, {sort_config.digit_bits} bits a sort pass; "
    if device.software:
        return f"{text}rasteriser tiles: software drivers always use them"
    if not device.blends_floats:
        return f"{text}rasteriser tiles: the device cannot blend 32-bit floats"
    timings = _timings_by_device[_device_key(device)]
    large_kernels, small_kernels, quads = (
        f"{1e3 * seconds:.2f} ms" for seconds in (timings.tiles, timings.small_tiles, timings.quads)
    )
    measured = f"tiles of {LARGE_TILE} {large_kernels}, of {TILE} {small_kernels}, quads {quads}"
    return f"{text}rasteriser {timings.fastest_rasteriser}: {measured}"


def measure_options(
    device: Device,
    kernels: Kernels,
    *,
    gaussians: int = _SAMPLE_GAUSSIAN_COUNT,
    size: tuple[int, int] = _IMAGE_SIZE,
) -> Timings:
    """Draw a test frame with each rasteriser several times, and return the median seconds.

    The times are GPU timestamps of the stages that differ. If timestamps stand still, they are
    wall-clock times of whole frames, which include the stages that both share.

    Args:
        device: The device to measure.
        kernels: Kernels of the device.
        gaussians: Number of Gaussians in the test frame.
        size: Width and height of the image, in pixels.
    """
    camera = Camera(
        np.eye(4),
        fx=size[0],
        fy=size[0],
        cx=size[0] / 2,
        cy=size[1] / 2,
        width=size[0],
        height=size[1],
    )
    data = _random_splats(gaussians, size[1] / size[0])
    residency = Residency(device)
    residency.begin(data)
    placed = [(SplatSet(data), page) for page in residency.pages(data)]
    small_kernels = Kernels(device, sort_config=replace(kernels.sort_config, tile=TILE))
    options = {
        "tiles": (kernels, _TILE_STAGES),
        "quads": (kernels, ("quads",)),
        "small": (small_kernels, _TILE_STAGES),
    }
    seconds = {
        option: _measure_seconds(device, plan, placed, camera, stages)
        for option, (option_kernels, stages) in options.items()
        for plan in [
            _plan_with_capacity(
                option_kernels, placed, camera, "quads" if option == "quads" else "tiles"
            )
        ]
    }
    # GPU timestamps of one and wall clock of the other would not compare.
    clock_index = 0 if min(gpu_seconds for gpu_seconds, _ in seconds.values()) > 0 else 1
    return Timings(*(seconds[option][clock_index] for option in ("tiles", "quads", "small")))


def _random_splats(n: int, aspect_ratio: float) -> SplatData:
    """Return random Gaussians of a few pixels that cover the image several times over."""
    rng = np.random.default_rng(0)
    rows = np.zeros((n, 10), np.float32)
    z = rng.uniform(2, 8, n)
    screen_offsets = rng.uniform(-0.5, 0.5, (n, 2)) * (1, aspect_ratio)
    rows[:, :2], rows[:, 2] = screen_offsets * z[:, None], z
    rows[:, 3] = rng.beta(1.2, 0.8, n)
    for column in (4, 7, 9):
        rows[:, column] = np.square(z * 2e-3 * np.exp(0.6 * rng.normal(size=n)))
    return SplatData(rows, rng.uniform(size=(n, 3)).astype(np.float32), "rgb")


def _plan_with_capacity(
    kernels: Kernels, placed: list[PlacedPage], camera: Camera, rasteriser: Rasteriser
) -> Plan:
    """Record a frame's GPU commands with buffers large enough for all splat-tile pairs."""
    pair_capacity, image = _FIRST_PAIR_CAPACITY, ImageSpec(size=(camera.width, camera.height))
    while True:
        method = RasterMethod(pair_capacity=pair_capacity, rasteriser=rasteriser)
        plan = Plan(kernels, placed, image, method)
        plan.submit(placed, camera, _BLACK_RGB, fetch=False)
        counts, _ = plan.collect(fetch=False)
        if rasteriser == "quads" or counts[Counts.WANTED_PAIRS] <= pair_capacity:
            return plan
        pair_capacity = int(counts[Counts.WANTED_PAIRS])


def _measure_seconds(
    device: Device, plan: Plan, placed: list[PlacedPage], camera: Camera, stages: tuple[str, ...]
) -> tuple[float, float]:
    """Return the median GPU seconds of given stages (0 without timestamps) and of whole frames."""
    clock = StageClock(device) if device.has_clock else None
    gpu_times, wall_times = [], []
    for number in range(_WARM_UP_FRAMES + _MEASURED_FRAMES):
        start_time = time.perf_counter()
        plan.submit(placed, camera, _BLACK_RGB, clock=clock, fetch=False)
        plan.collect(fetch=False)
        wall_seconds = time.perf_counter() - start_time
        gpu_seconds = clock.seconds() if clock is not None else dict.fromkeys(stages, 0.0)
        if number >= _WARM_UP_FRAMES:
            wall_times.append(wall_seconds)
            gpu_times.append(sum(gpu_seconds[name] for name in stages))
    return float(np.median(gpu_times)), float(np.median(wall_times))


_timings_by_device: dict[str, Timings] = {}


def _device_key(device: Device) -> str:
    """Return the cache key of an adapter with its driver."""
    info = device.raw.adapter.info
    info_fields = ("vendor", "device", "description", "backend_type")
    return " | ".join(
        [*(str(info.get(field, "")) for field in info_fields), f"probe {_PROBE_VERSION}"]
    )


def _cache_file() -> Path | None:
    """Return the path of the cached rasteriser timings, or None if GSGEN_NO_CACHE is set."""
    if os.environ.get("GSGEN_NO_CACHE"):
        return None
    from platformdirs import user_cache_path

    return user_cache_path("gsgen", appauthor=False) / "rasterisers.json"


def _read_cache() -> dict[str, Timings]:
    """Read the cached rasteriser timings; an unreadable file or another format counts as empty."""
    path = _cache_file()
    try:
        if path is None or path.stat().st_size > _MAX_CACHE_BYTES:
            return {}
        document = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    if not isinstance(document, dict):
        return {}
    return {
        key: timings for key, entry in document.items() if (timings := _timings(entry)) is not None
    }


def _timings(entry: object) -> Timings | None:
    names = [field.name for field in fields(Timings)]
    if not isinstance(entry, dict) or set(entry) != set(names):
        return None
    numbers = [entry[name] for name in names]
    if not all(isinstance(number, float) and 0 < number < np.inf for number in numbers):
        return None
    return Timings(*cast("list[float]", numbers))


def _write_cache(measured: dict[str, Timings]) -> None:
    """Write the rasteriser timings to the cache; if that fails, each process measures again."""
    path = _cache_file()
    if path is None:
        return
    text = json.dumps({key: asdict(entry) for key, entry in measured.items()}, indent=2)
    with suppress(ConfigInvalid), atomic_write(path) as draft:
        draft.write_text(text + "\n", "utf-8")
