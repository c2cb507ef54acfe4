"""How exact the picture of a million Gaussians is: all its pixels beside the float64 oracle.

    python tests/bench/exactness.py [--size 640x360]

Run by ``make exactness``; it takes some minutes, for the oracle blends one Gaussian after the
other. It prints the PSNR over all pixels, the largest error away from declared discontinuities,
how many depths a float does not tell apart, and for the worst pixels what is behind their error.
It ends with 1 if the PSNR is below 80 dB, or an undeclared error above 1e-3.
"""

import argparse
import sys
from dataclasses import dataclass
from typing import Final

import numpy as np
from bench_renderer import NOTHING_BEHIND, room

from gsgen.runtime.gpu.device import Device
from gsgen.runtime.kernels.shared.shader import NO_ID
from gsgen.runtime.oracle import render as oracle
from gsgen.runtime.oracle.projection import ellipses
from gsgen.runtime.renderer.renderer import Renderer
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.scene import Scene
from support.measures import print_figure

BAR_PSNR: Final = 80.0
BAR_ERROR: Final = 1e-3
_WORST_PIXEL_COUNT: Final = 12
_CULL: Final = 1 / 255
_MIN_TRANSMITTANCE: Final = 1e-4
_TIE_EPSILON: Final = 1e-12  # of a depth: nearer to each other two are not told apart


@dataclass(frozen=True, slots=True, eq=False)
class Splats:
    """What is drawn, in float64, and what the renderer sorts it by."""

    mean: np.ndarray
    inverse: np.ndarray
    opacity: np.ndarray
    depth: np.ndarray
    rounded: np.ndarray
    keys: np.ndarray
    lows: np.ndarray


def psnr(error: np.ndarray) -> float:
    return float(-10 * np.log10(np.mean(error**2)))


def splats(renderer: Renderer, scene: Scene, camera: Camera) -> Splats:
    splat_set, placed = scene.sets[0], renderer.placed(scene)
    plan = renderer.plan(placed, camera, frozenset(["color"]))
    plan.submit(placed, camera, NOTHING_BEHIND, only=["project"])
    plan.collect()
    keys, lows = (
        renderer.device.read(plan.buffers[name], np.uint32, len(scene))
        for name in ("keys of Gaussians a", "lows")
    )
    where = [
        page.first + np.arange(page.capacity) if page.rows_of is None else page.rows_of
        for _, page in placed
    ]
    back = np.argsort(np.concatenate(where))
    keys, lows = keys[back], lows[back]
    drawn = keys != NO_ID
    rows = splat_set.data.rows[drawn].astype(np.float64)
    actual = ellipses(rows, splat_set, camera)
    naive_offsets = (rows[:, :3].astype(np.float32) - camera.eye.astype(np.float32)) @ camera.view[
        2, :3
    ].astype(np.float32)
    inverse = np.linalg.inv(actual.dilated_covariance)
    return Splats(
        actual.mean, inverse, rows[:, 3], actual.depth, naive_offsets, keys[drawn], lows[drawn]
    )


def describe(result: Splats) -> None:
    """Say how many neighbours in depth are in doubt, by what each way to sort knows of them."""
    order = np.argsort(result.depth, kind="stable")
    key, low, naive_offsets = (
        result.keys[order].astype(np.int64),
        result.lows[order].astype(np.int64),
        result.rounded[order],
    )
    swapped = (np.diff(key) < 0) | ((np.diff(key) == 0) & (np.diff(low) < 0))
    swapped &= np.diff(result.depth[order]) > _TIE_EPSILON * result.depth[order][1:]
    print_figure(
        f"of {len(order):,} splats, {int((np.diff(naive_offsets) < 0).sum()):,} stand before one that is "
    )
    print_figure(
        f"nearer if depths are worked out in float32; {int((np.diff(key) == 0).sum()):,} have the "
    )
    print_figure(
        f"rounded depth of the next; by both floats of a depth {int(swapped.sum()):,} are swapped"
    )


def reason(result: Splats, x: int, y: int) -> str:
    """Say what is behind the error of a pixel."""
    away = np.array([x, y]) + 0.5 - result.mean
    power = np.einsum("ni,nij,nj->n", away, result.inverse, away)
    alpha = result.opacity * np.exp(-0.5 * power)
    near = np.flatnonzero(alpha >= 0.9 * _CULL)
    near = near[np.argsort(result.depth[near], kind="stable")]
    rank = np.lexsort((near, result.lows[near], result.keys[near]))
    if (rank != np.arange(len(near))).any():
        first = int(np.flatnonzero(rank != np.arange(len(near)))[0])
        depth_gap = result.depth[near[first + 1]] - result.depth[near[first]]
        return f"two splats {depth_gap:.1e} apart, at {result.depth[near[first]]:.3f}, stand the other way around"
    drawn = np.minimum(np.where(alpha[near] >= _CULL, alpha[near], 0), 0.99)
    light = np.cumprod(1 - drawn)
    is_reached = np.append(1, light[:-1]) > _MIN_TRANSMITTANCE
    edge = float(np.abs(alpha[near][is_reached] / _CULL - 1).min(initial=np.inf))
    stop = float(np.abs(light[is_reached] / _MIN_TRANSMITTANCE - 1).min(initial=np.inf))
    if min(edge, stop) > 1e-2:
        return "no threshold is near: rounding"
    if edge < stop:
        return f"an alpha is 1/255 but for {edge:.1e}"
    return f"the light that is left is 1e-4 but for {stop:.1e}"


def main() -> int:
    """Print what there is to know; return 1 if it is not exact enough."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--size", default="640x360", help="WIDTHxHEIGHT (default: %(default)s)")
    parser.add_argument("--gaussians", type=int, default=1_000_000, help="(default: %(default)s)")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    camera = Camera.look_at((-2.5, -0.5, -3), (1, 0.3, 1), width=width, height=height)
    scene = Scene([room(arguments.gaussians)])
    renderer = Renderer(Device.open(), rasteriser="tiles")
    actual = renderer.render(scene, camera).rgba
    assert actual is not None
    describe(result := splats(renderer, scene, camera))
    frame = oracle.render(scene, camera)
    error = np.abs(actual - frame.rgba)
    max_error = error.max(axis=-1)
    undeclared = float(max_error[~frame.fragile].max())
    print_figure(
        f"{width}×{height}, {renderer.device.name}: {psnr(error):.1f} dB over all pixels; "
    )
    print_figure(
        f"largest error {max_error.max():.1e}, away from declared discontinuities {undeclared:.1e} "
    )
    print_figure(f"({100 * frame.fragile.mean():.1f} % of the pixels have one)")
    for pixel in np.argsort(max_error.ravel())[::-1][:_WORST_PIXEL_COUNT]:
        y, x = divmod(int(pixel), width)
        print_figure(f"  pixel {x:4}, {y:4}: {max_error[y, x]:.1e}: {reason(result, x, y)}")
    sys.stdout.write("\n")
    return int(not (psnr(error) >= BAR_PSNR and undeclared <= BAR_ERROR))


if __name__ == "__main__":
    sys.exit(main())
