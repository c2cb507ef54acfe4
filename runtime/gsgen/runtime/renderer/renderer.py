"""The renderer: draws a scene from a camera and returns a frame."""

__all__ = ["FIRST_PAIR_CAPACITY", "PAIR_CAPACITY_FACTOR", "Renderer"]

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Final, final

import numpy as np

from gsgen.runtime.errors import DeviceUnavailable, MemoryFull
from gsgen.runtime.gpu.device import MAX_WORKGROUPS, Device
from gsgen.runtime.gpu.mesh_residency import MeshResidency
from gsgen.runtime.gpu.splat_residency import Residency
from gsgen.runtime.kernels.project.project import Eyes
from gsgen.runtime.kernels.raster.mesh_place import PlacedMesh
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.shader import EYE_ROWS, LARGE_TILE
from gsgen.runtime.kernels.tiles.tile_ranges import RANGE_BLOCK
from gsgen.runtime.renderer.bands import (
    Band,
    BandImages,
    CountsAndImages,
    DrawnImage,
    PairsExceeded,
    band_rows,
    draw_bands,
    side_by_side,
)
from gsgen.runtime.renderer.frame_arguments import checked, have_one_order, memory_error
from gsgen.runtime.renderer.frame_counts import frame_counts
from gsgen.runtime.renderer.frame_images import FrameReadback, frame_of
from gsgen.runtime.renderer.frame_plan import Plan
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.renderer.late_counts import DelayedCounts, FrameInFlight, Readbacks
from gsgen.runtime.renderer.placed_pages import PlacedPage, scene_pages
from gsgen.runtime.renderer.plan_options import ImageSpec, Rasteriser, RasterMethod
from gsgen.runtime.renderer.rasteriser_choice import RasteriserOption, choose, chosen_sort_config
from gsgen.runtime.renderer.slabs import SlabSizes, extra_layers, max_slab_splats, max_sorted_rows
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import COLOR_OUTPUT_ONLY, Frame, Output
from gsgen.runtime.scene.scene import Scene

FIRST_PAIR_CAPACITY: Final = 1 << 16
"""Pairs of a splat and a tile for which a new renderer has room."""
PAIR_CAPACITY_FACTOR: Final = 1.25
"""Room for pairs, times those that a frame needed, so that the next rarely needs to grow."""
_PAIR_BUFFER_GROWTH_THRESHOLD: Final = 0.9  # of the room for pairs: more is made early
_UNLIMITED_SPLATS: Final = 1 << 32  # splats: more than any device draws at once


@final
class Renderer:
    """Draws scenes of Gaussians and meshes on a graphics device.

    Buffers and pipelines are reused until the image size, the outputs or the sets change;
    cameras, transforms and values may change from frame to frame.

    Args:
        device: The device; the fastest adapter if None.
        rasteriser: "tiles" blends colours in compute shaders, tile by tile; "quads" lets the
            hardware blend one quad per splat, which cannot stop at finished pixels. "auto"
            measures once which is faster (:mod:`gsgen.runtime.renderer.rasteriser_choice`), and
            with which tiles; it uses tiles on software drivers and for other outputs than colours.
        compact: Whether SH and colours are float16, and covariances take 16 bytes: 128 instead of
            232 bytes per Gaussian of degree 3, 40 instead of 56 for RGB; pictures differ by less
            than 1e-3, or 4e-3 where a threshold is met.
        page_rows: Most Gaussians of a dispatch and binding: by default 262,144, on GPUs twice that.
        published: Whether weighted sums count backgrounds as the method's own renderer does
            (Liu et al. 2025): the background keeps its whole weight in the numerator. Such
            pictures compare with that renderer's, but cannot be composed with others.

    Attributes:
        rasteriser: The requested or chosen rasteriser of colours.
        late_counts: Counts of frames in flight, after ``draw(wait=False)``.
        growths: How often the buffers of pairs of a splat and a tile were enlarged.

    Raises:
        DeviceUnavailable: There is no device, or it does not support the ``rasteriser``.
    """

    def __init__(
        self,
        device: Device | None = None,
        *,
        rasteriser: RasteriserOption = "auto",
        compact: bool = False,
        page_rows: int | None = None,
        published: bool = False,
    ) -> None:
        self._is_published, self._is_compact = published, compact
        self.device = device or Device.open()
        self.device.require()
        with self.device.translate_errors():
            self._kernels = Kernels(self.device)
        self._residency = Residency(self.device, page_rows, compact=compact)
        self._mesh_residency, self._band_images = (
            MeshResidency(self.device),
            BandImages(self.device),
        )
        self._pairs = min(FIRST_PAIR_CAPACITY, self._max_pairs)
        if rasteriser == "quads" and not self.device.blends_floats:
            raise DeviceUnavailable(
                f"{self.device.name} cannot blend 32-bit floats", hint="Use the rasteriser 'tiles'."
            )
        self._chooses_rasteriser = rasteriser == "auto"
        self.rasteriser: Rasteriser = "tiles" if rasteriser == "auto" else rasteriser
        if rasteriser == "auto":
            with self.device.translate_errors():
                self.rasteriser = choose(self.device, self._kernels)
                if (sort_config := chosen_sort_config(self.device)) != self._kernels.sort_config:
                    self._kernels = Kernels(self.device, sort_config=sort_config)
        self._has_deep_tiles, self._slab_limit = False, _UNLIMITED_SPLATS
        self._rows: object = None
        self._plan_key: object = None
        self._plan: Plan | None = None
        self._plan_shape: object = None
        self._steady_counts: tuple[object, np.ndarray] | None = None
        self.late_counts, self._readbacks, self.growths = (DelayedCounts(), Readbacks(), 0)

    def render(
        self,
        scene: Scene,
        camera: Camera,
        *,
        background: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
        outputs: Collection[Output] = COLOR_OUTPUT_ONLY,
        right: Camera | None = None,
    ) -> Frame:
        """Draw a scene as a camera sees it, and return the images.

        Args:
            scene: The scene.
            camera: The camera, with the image size.
            background: Red, green, blue and alpha of the background.
            outputs: Images to compute.
            right: A right eye, whose images stand at the right of those of ``camera``. Splats that
                both see at one depth are sorted once; else the eyes are drawn one by one.

        Raises:
            CapacityExceeded: The scene or the image is larger than the device's buffers.
            DeviceLost: The device was lost.
            MemoryFull: The device has no memory for the scene or the image.
            SceneInvalid: ``background`` or ``outputs`` is invalid.
        """
        counts, images = self._draw_images(scene, camera, background, outputs, right)
        eyes = (camera,) if right is None else (camera, right)
        return frame_of(scene, eyes, counts, images, float(background[3]))

    def submit(
        self,
        scene: Scene,
        camera: Camera,
        *,
        background: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
        outputs: Collection[Output] = COLOR_OUTPUT_ONLY,
    ) -> FrameInFlight:
        """Begin to draw a scene, without waiting for the GPU; :meth:`collect` returns the images.

        The first frame of other sets or of another size is waited for, and so are frames in slabs
        or bands. Arguments and errors are those of :meth:`render`.
        """
        requested, rgba = checked(scene, outputs, background, published=self._is_published)
        with self._device_errors(scene, camera):
            if self._band_rows(scene, camera, len(requested)) >= camera.height:
                placed, meshes = self._upload_scene(scene)
                plan = self.plan(placed, camera, requested, meshes)
                if self._has_steady_counts(plan):
                    images, color = self._readbacks.take(plan), rgba[:3]
                    plan.submit(placed, camera, color, meshes=meshes, staging=images.staging)
                    images.staging.begin()
                    return FrameInFlight(scene, camera, float(rgba[3]), images)
                del plan  # its memory goes before that of a larger one comes
        drawn = self._draw_images(scene, camera, background, outputs)
        self._steady_counts = (self._plan_shape, drawn[0])
        return FrameInFlight(scene, camera, float(rgba[3]), drawn)

    def collect(self, frame: FrameInFlight) -> Frame | None:
        """Return the images of a frame of :meth:`submit`, once; wait for this frame alone.

        None if its buffers were too small: the scene must then be drawn again as it was. Errors are
        those of :meth:`render`.
        """
        drawn = frame.images
        if isinstance(drawn, FrameReadback):
            with self._device_errors(frame.scene, frame.camera):
                readback, drawn = drawn, drawn.collect()
                self._readbacks.return_readback(readback)
                if self._is_incomplete(drawn[0]):
                    return None
        return frame_of(frame.scene, (frame.camera,), *drawn, frame.opacity_behind)

    def draw(
        self,
        scene: Scene,
        camera: Camera,
        *,
        background: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
        output: Output = "color",
        wait: bool = True,
    ) -> DrawnImage:
        """Draw one output of a scene, and leave the image in GPU memory to be shown from there.

        Further arguments, and errors, are those of :meth:`render`.

        Args:
            scene: The scene.
            camera: The camera, with the image size.
            background: Red, green, blue and alpha of the background.
            output: The image to compute.
            wait: Whether to wait for the GPU. Otherwise only the first of the frames of the same
                sets and size is waited for. Counts are those of an earlier frame then, and splats
                may be missing until :meth:`settle` returns False.
        """
        if wait:
            self._steady_counts = None
            plan, counts = self._draw_in_one_submit(scene, Band.of(camera), background, output)
        else:
            requested, rgba = checked(scene, (output,), background, published=self._is_published)
            with self._device_errors(scene, camera):
                plan, counts = self._draw_with_late_counts(scene, camera, rgba, requested)
        return DrawnImage.of(plan.images[output], Band.of(camera), counts)

    def draw_bands(
        self,
        scene: Scene,
        camera: Camera,
        *,
        background: Sequence[float] = (0.0, 0.0, 0.0, 0.0),
        output: Output = "color",
        wait: bool = True,
    ) -> list[DrawnImage]:
        """Draw one output of a scene into one GPU buffer, or into several if it is too large.

        Arguments and errors are those of :meth:`draw`. Frames of several buffers are waited for,
        and a Gaussian counts in each band that it touches. The buffers change with the next frame.
        """
        rows = self._band_rows(scene, camera, 1)
        if rows >= camera.height:
            self._band_images.clear()
            return [self.draw(scene, camera, background=background, output=output, wait=wait)]
        drawn = list[DrawnImage]()

        def draw(band: Band) -> CountsAndImages:
            plan, counts = self._draw_in_one_submit(scene, band, background, output)
            image = self._band_images.copy(len(drawn), plan.images[output])
            drawn.append(DrawnImage.of(image, band, counts))
            return counts, {}

        self._steady_counts = None
        with self.device.translate_errors():
            draw_bands(camera, rows, draw, lambda: None)
        return drawn

    def _draw_images(
        self,
        scene: Scene,
        camera: Camera,
        background: Sequence[float],
        outputs: Collection[Output],
        right: Camera | None = None,
    ) -> CountsAndImages:
        """Draw a scene in as many bands of image rows as its buffers need, and read the images."""
        requested, rgba = checked(scene, outputs, background, published=self._is_published)
        with self._device_errors(scene, camera):
            placed, meshes = self._upload_scene(scene)
            if right is not None and not (
                have_one_order(scene, camera, right, requested)
                and self._rasteriser_of(requested) == "tiles"
                and 2 * max_sorted_rows(placed) + EYE_ROWS <= self._max_slab_splats
            ):
                images = partial(self._draw_images, scene, background=background, outputs=outputs)
                return side_by_side(images(camera), images(right))

            def draw(band: Band) -> CountsAndImages:
                return self._redraw(scene, band, rgba, requested, placed, meshes, right=right)[1:]

            rows = self._band_rows(scene, camera, len(requested))
            return draw_bands(
                camera, rows, draw, lambda: self._plan and self._plan.visible(placed, camera)
            )

    def _band_rows(self, scene: Scene, camera: Camera, images: int) -> int:
        """Return how many rows of an image are drawn at once: all, if buffers can hold them."""
        layers = bool(scene.meshes) + any(splat_set.weighted for splat_set in scene.sets)
        slab_layers = extra_layers(scene, self.device, self._max_slab_splats)
        return band_rows(self.device, camera, images, layers + slab_layers)

    def _draw_in_one_submit(
        self, scene: Scene, band: Band, background: Sequence[float], output: Output
    ) -> tuple[Plan, np.ndarray]:
        """Draw a whole image, or a band of it, which stays in one GPU buffer."""
        requested, rgba = checked(scene, (output,), background, published=self._is_published)
        with self._device_errors(scene, band.full_camera):
            placed, meshes = self._upload_scene(scene)
            return self._redraw(scene, band, rgba, requested, placed, meshes, fetch=False)[:2]

    @contextmanager
    def _device_errors(self, scene: Scene, camera: Camera) -> Iterator[None]:
        """Translate GPU errors in a ``with`` block; memory errors then name the scene's size."""
        try:
            with self.device.translate_errors():
                yield
        except MemoryFull as error:
            # Free the plan and its rows, which Python 3.13 ties to the traceback of the cause.
            self._plan = self._plan_key = self._rows = self._plan_shape = self._steady_counts = None
            error.with_traceback(None)
            self._readbacks.clear()
            self._pairs = min(FIRST_PAIR_CAPACITY, self._max_pairs)
            raise memory_error(scene, camera, error, compact=self._is_compact) from error

    def _upload_scene(self, scene: Scene) -> tuple[list[PlacedPage], list[PlacedMesh]]:
        """Upload changed splats and meshes of a scene; return the GPU buffers of both."""
        placed, meshes = self.placed(scene), self.placed_meshes(scene)
        # A frame that needs more pairs is drawn twice: a flight through a pool has no such frame.
        pooled_rows = sum(len(pooled.pool) for pooled in scene.pools)
        self._pairs = max(self._pairs, min(pooled_rows, self._max_pairs))
        return placed, meshes

    def _redraw(
        self,
        scene: Scene,
        band: Band,
        rgba: np.ndarray,
        requested: frozenset[Output],
        placed: list[PlacedPage],
        meshes: list[PlacedMesh],
        *,
        fetch: bool = True,
        right: Camera | None = None,
    ) -> tuple[Plan, np.ndarray, dict[str, np.ndarray]]:
        """Redraw until all splat-tile pairs fit their buffer and equal depth keys are ordered."""
        while True:
            # Step 1: draw with the present sizes of buffers.
            plan = self.plan(placed, band.camera, requested, meshes, eyes=2 if right else 1)
            counts, images = plan.draw(
                placed, band, rgba[:3], meshes=meshes, fetch=fetch, right=right
            )
            # Step 2: the counts tell if pairs, or the order of equal depths, are missing.
            try:
                if not self._must_redraw(counts):
                    self._grow_pair_buffers_early(counts)
                    return plan, counts, images
            except PairsExceeded:
                # Narrower bands have fewer pairs; an image that stays on the GPU has one band.
                is_divisible = fetch and band.rows > LARGE_TILE
                if is_divisible or right is not None or not self._halve_slabs(placed):
                    raise
                continue
            # Step 3: rows that were rearranged in memory, and share a depth, return to their own order.
            if counts[Counts.TIED]:
                for splat_set in scene.sets:
                    self._residency.restore_order(splat_set.data)
                placed[:] = scene_pages(scene, self._residency)

    def _draw_with_late_counts(
        self, scene: Scene, camera: Camera, rgba: np.ndarray, requested: frozenset[Output]
    ) -> tuple[Plan, np.ndarray]:
        """Draw a frame with an earlier frame's buffer sizes; if unknown, wait for the GPU."""
        for parts in self.late_counts.read():
            self._is_incomplete(frame_counts(self.device, self._kernels, parts))
        placed, meshes = self._upload_scene(scene)
        plan = self.plan(placed, camera, requested, meshes)
        if self._steady_counts is None or not self._has_steady_counts(plan):
            self._steady_counts = None  # keeps the rows of other sets
            plan, counts, _ = self._redraw(
                scene, Band.of(camera), rgba, requested, placed, meshes, fetch=False
            )
            self._steady_counts = (self._plan_shape, counts)
            return plan, counts
        staging = self.late_counts.staging(plan)
        plan.submit(placed, camera, rgba[:3], meshes=meshes, fetch=False, staging=staging)
        self.late_counts.add(staging)
        return plan, self._steady_counts[1]

    def _has_steady_counts(self, plan: Plan) -> bool:
        """Return whether an earlier frame of the same sets and size told the buffers' sizes."""
        uses_slabs = plan.slabs or plan.weighted_slabs
        return (
            not uses_slabs
            and self._steady_counts is not None
            and self._steady_counts[0] == self._plan_shape
        )

    def _is_incomplete(self, counts: np.ndarray) -> bool:
        """Return whether an earlier frame lacks splats or their order; enlarge small buffers."""
        try:
            is_incomplete = self._must_redraw(counts)
        except PairsExceeded:  # the next frame is waited for, and drawn in thinner slabs
            self._steady_counts = None
            return True
        if self._steady_counts is not None:
            # If rows must return to their own order, the next frame is waited for.
            self._steady_counts = None if counts[Counts.TIED] else (self._steady_counts[0], counts)
        self._grow_pair_buffers_early(counts)
        return is_incomplete

    def _grow_pair_buffers_early(self, counts: np.ndarray) -> None:
        """Enlarge the buffers of pairs before a frame that needs it would be drawn twice."""
        if int(counts[Counts.WANTED_PAIRS]) > _PAIR_BUFFER_GROWTH_THRESHOLD * self._pairs:
            self._grow_pair_capacity(min(int(counts[Counts.WANTED_PAIRS]), self._max_pairs))

    def settle(self) -> bool:
        """Wait for frames of ``draw(wait=False)``; return whether the last one needs a redraw."""
        is_incomplete = False
        with self.device.translate_errors():
            for parts in self.late_counts.read(in_flight=0):
                is_incomplete = self._is_incomplete(frame_counts(self.device, self._kernels, parts))
        if is_incomplete:
            self._steady_counts = None
        return is_incomplete

    def _must_redraw(self, counts: np.ndarray) -> bool:
        """Return whether a frame must be drawn again; enlarge the buffers that were too small."""
        has_too_few_pairs = int(counts[Counts.WANTED_PAIRS]) > int(counts[Counts.PAIR_CAPACITY])
        if int(counts[Counts.WANTED_PAIRS]) > self._pairs:
            self._grow_pair_capacity(int(counts[Counts.WANTED_PAIRS]))
        if counts[Counts.UNSORTED]:
            self._has_deep_tiles = True
        return bool(has_too_few_pairs or counts[Counts.UNSORTED] or counts[Counts.TIED])

    def placed(self, scene: Scene) -> list[PlacedPage]:
        """Return the GPU buffers (pages) of each splat set of a scene, after uploading changes."""
        for data in dict.fromkeys(splat_set.data for splat_set in scene.sets):
            self._residency.begin(data)
        return scene_pages(scene, self._residency)

    def placed_meshes(self, scene: Scene) -> list[PlacedMesh]:
        """Return each mesh of a scene with its GPU buffers, after uploading new meshes."""
        buffers = self._mesh_residency.buffers
        return [PlacedMesh(mesh, buffers(mesh.data), scene.color_space) for mesh in scene.meshes]

    def plan(
        self,
        placed: Sequence[PlacedPage],
        camera: Camera,
        outputs: frozenset[Output],
        meshes: Sequence[PlacedMesh] = (),
        eyes: Eyes = 1,
    ) -> Plan:
        """Return a frame's recorded GPU work: the last one if only buffer values changed."""
        pages = tuple((page, splat_set.weighted is None) for splat_set, page in placed)
        contents = (pages, tuple(mesh.buffers for mesh in meshes))
        rows = [page.rows for _, page in placed]
        if rows != self._rows:
            # Others may have depths farther apart, or fewer pairs.
            self._rows, self._has_deep_tiles, self._slab_limit = rows, False, _UNLIMITED_SPLATS
        image = ImageSpec.of(camera, outputs, eyes)
        if meshes:
            image.require_meshes()
        self._plan_shape = (contents, image)
        key = (self._plan_shape, self._pairs, self._has_deep_tiles, self._slab_limit)
        if self._plan is None or key != self._plan_key:
            self._plan, self._plan_key = None, None  # its memory goes before the new one's comes
            self._readbacks.clear()
            slabs = SlabSizes.of(placed, self._max_slab_splats)
            method = RasterMethod(
                pair_capacity=self._pairs,
                rasteriser="tiles" if slabs.splats else self._rasteriser_of(outputs),
                sort="deep" if self._has_deep_tiles else "by key",
                backgrounds="published" if self._is_published else "composed",
                slabs=slabs,
            )
            self._plan = Plan(self._kernels, placed, image, method, meshes=meshes)
            self._plan_key = key
        return self._plan

    def _rasteriser_of(self, outputs: frozenset[Output]) -> Rasteriser:
        """Return what blends colours: a rasteriser that was measured draws nothing but colours."""
        return "tiles" if self._chooses_rasteriser and outputs != {"color"} else self.rasteriser

    @property
    def _max_slab_splats(self) -> int:
        """The most splats of a depth slab."""
        return min(max_slab_splats(self.device, self._kernels), self._slab_limit)

    def _halve_slabs(self, placed: Sequence[PlacedPage]) -> bool:
        """Halve the limit of splats per depth slab; return whether that is possible."""
        max_splats = min(max_sorted_rows(placed), self._max_slab_splats)
        if max_splats < 2:
            return False
        self._slab_limit = max_splats // 2
        return True

    @property
    def _max_pairs(self) -> int:
        """The largest number of splat-tile pairs that the GPU device can hold."""
        return int(min(self.device.largest_binding // 4, MAX_WORKGROUPS * RANGE_BLOCK))

    def _grow_pair_capacity(self, pairs: int) -> None:
        """Increase the capacity for splat-tile pairs; raise if the device cannot hold as many."""
        max_pairs = self._max_pairs
        if pairs > max_pairs:
            raise PairsExceeded.of(pairs, max_pairs, self.device)
        before, self._pairs = self._pairs, min(int(pairs * PAIR_CAPACITY_FACTOR), max_pairs)
        self.growths += self._pairs > before
