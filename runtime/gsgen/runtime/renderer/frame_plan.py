"""The frame plan: all GPU buffers and dispatches of a frame, recorded once and reused."""

__all__ = ["Plan"]

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import final

import numpy as np
from jaxtyping import Float

from gsgen.runtime.gpu.gpu_timer import StageClock
from gsgen.runtime.gpu.handles import Buffer
from gsgen.runtime.gpu.readback import StagingBuffers
from gsgen.runtime.kernels.project.project import FRAME, PAGE, frame_uniform
from gsgen.runtime.kernels.raster.draw_meshes import MeshesStep
from gsgen.runtime.kernels.raster.draw_quads import QuadsStep
from gsgen.runtime.kernels.raster.mesh_place import (
    MESH_UNIFORM,
    PlacedMesh,
    mesh_rays,
    mesh_uniform,
)
from gsgen.runtime.kernels.shared import counts as counting
from gsgen.runtime.kernels.shared.counts import Counts
from gsgen.runtime.kernels.shared.kernel import VEC4, Step, run
from gsgen.runtime.kernels.sort.sort import KEY_BITS, Columns
from gsgen.runtime.kernels.tiles.blend_tiles import Layers, allocate_layers
from gsgen.runtime.renderer.bands import Band, CountsAndImages
from gsgen.runtime.renderer.frame_images import CountedItems, FrameReadback
from gsgen.runtime.renderer.kernel_set import Kernels
from gsgen.runtime.renderer.placed_pages import (
    PlacedPage,
    scene_order,
    sorted_pages,
    weighted_pages,
    write_pages,
)
from gsgen.runtime.renderer.plan_options import ImageSpec, RasterMethod
from gsgen.runtime.renderer.slabs import Slabs, SlabState, draw_parts
from gsgen.runtime.renderer.tile_lists import (
    EyeSplats,
    SplatArrays,
    TileBlending,
    TileLists,
    allocate_columns,
    draw_eyes,
    draw_tiles,
    stages_of_eye,
)
from gsgen.runtime.renderer.weighted_plan import WeightedPart
from gsgen.runtime.scene.camera import Camera
from gsgen.runtime.scene.frame import Output


@final
class Plan:
    """GPU buffers and dispatches that draw Gaussians and meshes at one image size.

    Args:
        kernels: Kernels of a device.
        placed: The pages; only their buffers and types are kept.
        image: The images to draw.
        method: How they are drawn.
        meshes: Meshes among the Gaussians; only their buffers are kept.
        layers: Image layers that the caller writes, into inputs; only for sorted colours.

    Attributes:
        image: The images to draw.
        stages: Steps of a frame, by stage; those of a right eye are drawn after the left one.
        buffers: Buffers of the plan, by name.
        clears: Buffers whose bytes are zero at the start of a frame, from an offset on; None for
            all further bytes.
        images: The buffers that :meth:`collect` reads, by output.
        inputs: The uniforms that :meth:`submit` writes, and the counts, by name.
        slabs: Buffers and steps of sorted sets that are drawn in slabs of depth, or None.

    Raises:
        CapacityExceeded: A buffer would be larger than the device binds.
    """

    def __init__(
        self,
        kernels: Kernels,
        placed: Sequence[PlacedPage],
        image: ImageSpec,
        method: RasterMethod,
        *,
        meshes: Sequence[PlacedMesh] = (),
        layers: int = 0,
    ) -> None:
        device, sizes, outputs = kernels.device, method.slabs, image.outputs
        # Step 1: divide the sets by the way in which they are blended.
        weighted_pairs, placed = weighted_pages(placed), sorted_pages(placed)
        self._weighted_part: WeightedPart | None = None
        self._quads_step: QuadsStep | None = None
        self._meshes: MeshesStep | None = None
        self._device, self._kernels = device, kernels
        self.image, self._rasterisation = image, method
        self._tiles = image.tiles(kernels.sort_config.tile)
        n = self._gaussians = sizes.splats or sum(page.capacity for _, page in placed)
        self._origins = scene_order(placed)
        # Step 2: allocate what each frame writes: uniforms, counts, and buffers that begin as zeros.
        self._frame_uniform = device.uniform("frame", FRAME.itemsize)
        self._black_frame = device.uniform("frame with nothing behind", FRAME.itemsize)
        self._slots = device.uniform("pages", PAGE.itemsize * max(1, len(placed)))
        self._mesh_slots = device.uniform("meshes", MESH_UNIFORM.itemsize * max(1, len(meshes)))
        self.buffers: dict[str, Buffer] = {}
        self.slabs = self._depth_slabs(placed, sizes.splats, with_ids="depth" in outputs)
        self._counts = self._storage("counts", counting.COUNTERS_BYTES, extra_usage="INDIRECT")
        initial_counts = counting.initial(n, method.pair_capacity, panorama=image.panorama)
        device.write(self._counts, initial_counts)
        self._counters = {"counts": self._counts}
        self._ranges = self._storage("ranges", 8 * self._tiles[0] * self._tiles[1])
        self.inputs = {"frame": self._frame_uniform, "bare frame": self._black_frame}
        self.inputs |= {"pages": self._slots, "counts": self._counts}
        self._layers = self._allocate_input_layers(layers) if layers else None
        self.buffer_clears = self._cleared_buffers()
        self.images: dict[str, Buffer] = {}
        # Step 3: find out who writes the image. Meshes and weighted sets become layers among the splats,
        # unless weighted sets are alone.
        # Weighted sets become a layer, which quads do not blend.
        quads = method.rasteriser == "quads" and not weighted_pairs
        is_weighted_only = (
            bool(weighted_pairs) and not placed and not meshes
        )  # they write the image, without layers
        tiled_outputs = outputs - {"color"} if quads else outputs
        if tiled_outputs and not is_weighted_only and (meshes or weighted_pairs):
            count, normal = bool(weighted_pairs) + bool(meshes), "normal" in tiled_outputs
            numbers = sizes.numbers_per_pixel(count, normal=normal)
            self._layers = allocate_layers(
                self._storage, count, image.size, normal=normal, numbers=numbers
            )
        # Step 4: record the stages, in the order of their execution.
        self.stages: dict[str, list[Step]] = {}
        if meshes:
            self.stages["meshes"] = self._draw_meshes(meshes)
        if weighted_pairs:
            frames = (self._frame_uniform, self._black_frame)
            self._weighted_part = WeightedPart(
                kernels, weighted_pairs, image, method, frames, self._layers
            )
            self._add_weighted_part(self._weighted_part)
        if is_weighted_only and self._weighted_part is not None:
            self.inputs |= self._weighted_part.inputs
        else:
            self.stages |= self._record(placed, outputs, quads=quads)
        self.buffer_clears += [(page.slots.dispatch, 0, 4) for _, page in placed if page.slots]
        self._readback = self.readback()

    @property
    def weighted_slabs(self) -> Slabs | None:
        """Buffers and steps of weighted sets that are drawn in slabs of depth, or None."""
        return None if self._weighted_part is None else self._weighted_part.slabs

    def _add_weighted_part(self, part: WeightedPart) -> None:
        """Add the GPU buffers, images and stages of weighted-sum rendering to a frame."""
        self.buffers |= part.buffers
        self.images |= part.images
        self.stages |= part.stages
        self.buffer_clears += part.buffer_clears
        self._counters["counts of cells"] = part.counts

    def _depth_slabs(
        self, placed: Sequence[PlacedPage], splats: int | None, *, with_ids: bool
    ) -> Slabs | None:
        """Return the depth ranges (slabs) in which a scene is drawn, one after the other."""
        if splats is None:
            return None
        pages = [page for _, page in placed]
        slabs = Slabs(self._kernels, pages, splats, self._origins, with_ids=with_ids)
        self.buffers |= slabs.buffers
        self._origins = None
        return slabs

    def _storage(self, name: str, size: int, *, extra_usage: str = "") -> Buffer:
        self.buffers[name] = self._device.storage(name, size, extra_usage=extra_usage)
        return self.buffers[name]

    def _shared_storage(self, name: str, size: int) -> Buffer:
        """Return the buffer of this name, which another eye uses, too, or a new one."""
        return self.buffers[name] if name in self.buffers else self._storage(name, size)

    def _cleared_buffers(self) -> list[tuple[Buffer, int, int | None]]:
        """Return GPU buffers to clear before a frame, with offset and size; stages add others."""
        return [
            (self._ranges, 0, None),
            (self._counts, 4 * Counts.TIED, 8),  # and UNSORTED
            *((slabs.key_counts, 0, None) for slabs in (self.slabs,) if slabs is not None),
        ]

    def _record(
        self, placed: Sequence[PlacedPage], outputs: frozenset[Output], *, quads: bool
    ) -> dict[str, list[Step]]:
        """Record the GPU stages that draw the depth-sorted splat sets, in execution order."""
        n = self._gaussians
        # Stage 1: a splat, a sort key and a depth remainder for every Gaussian.
        a, b = (allocate_columns(self._storage, f"Gaussians {side}", n) for side in "ab")
        splats = SplatArrays(self._kernels, self._storage, n, self.image.eyes)
        self._records = splats.records
        normals = self._storage("normals", VEC4 * n) if "normal" in outputs else None
        digits = self._first_digits()
        stages = self._project(placed, a.keys, splats.written, normals, digits[:1])
        # Stage 2: sort the drawn splats, nearest first, exactly: blending depends on the order.
        stages["sort"], order = self._sort_by_depth((a, b), splats.low_keys, digits)
        # Stage 3, by the hardware: quads need no tiles, so colours are complete here.
        if quads and "color" in outputs:
            self._quads_step = self._draw_quads(order, splats.of_eye(0))
            outputs = outputs - {"color"}
        # Stages 3 to 5, by tiles, for each eye.
        for eye in range(self.image.eyes) if outputs else ():
            lists = TileLists(
                storage=self._shared_storage,
                frame=self._frame_uniform,
                counts=self._counts,
                order=order,
                splats=splats.of_eye(eye),
                ranges=self._ranges,
                scratch_buffer=a.keys,
                gaussians=n,
                pair_capacity=self._rasterisation.pair_capacity,
                tiles=self._tiles[0] * self._tiles[1],
            )
            blending = TileBlending(
                image=self.image,
                outputs=outputs,
                bare_frame=self._black_frame,
                normals=normals,
                layers=self._layers,
                has_slabs=self.slabs is not None,
                taker_ids=None if self.slabs is None else self.slabs.taker_ids,
            )
            drawn = draw_tiles(self._kernels, lists, blending, records=self._records)
            stages |= stages_of_eye(eye, drawn.stages)
            self.images |= drawn.images
            self.buffer_clears += [(buffer, 0, None) for buffer in drawn.cleared]
        return stages

    def _allocate_input_layers(self, count: int) -> Layers:
        """Allocate GPU buffers for image layers (colours and depths) that the application fills."""
        layers = allocate_layers(self._storage, count, self.image.size, normal=False)
        self.inputs |= {"layer colors": layers.colors, "layer depths": layers.depths}
        return layers

    def _draw_meshes(self, meshes: Sequence[PlacedMesh]) -> list[Step]:
        """Record drawing the meshes; return dispatches that copy the pixels to an image layer."""
        self._mesh_rays = self._storage("rays of meshes", 8 * sum(self.image.size))
        self._meshes = self._kernels.meshes(panorama=self.image.panorama).step(
            self.image.size, meshes, self._mesh_slots, self._mesh_rays, self._layers
        )
        return list(self._meshes.layers)

    def _draw_quads(self, order: Buffer, splats: EyeSplats) -> QuadsStep:
        kernel = self._kernels.quads(
            has_depth_test=self._meshes is not None,
            panorama=self.image.panorama,
            records=self._records,
        )
        size = self.image.size
        self.images["color"] = self._storage("color image", kernel.row_bytes(size[0]) * size[1])
        resources = (self._frame_uniform, self._counts, order, *splats.vectors, splats.colors)
        image = self.images["color"]
        return kernel.step(size, resources, self._counts, image, self._meshes)

    def _project(
        self,
        placed: Sequence[PlacedPage],
        keys: Buffer,
        splats: tuple[Buffer, ...],
        normals: Buffer | None,
        digits: tuple[Buffer, ...],
    ) -> dict[str, list[Step]]:
        """Return the GPU stages that project all Gaussians, or those of a depth slab.

        Normals are computed here, because the sort overwrites the keys that mark absent Gaussians.
        """
        outputs = (self._frame_uniform, keys, *splats)
        if self.slabs is not None:
            steps = self.slabs.project_steps(
                outputs,
                self._counts,
                self._slots,
                normals,
                projection=self.image.projection,
                records=self._records,
            )
            return {
                "keys": self.slabs.key_steps(
                    outputs, self._slots, projection=self.image.projection
                ),
                "tally": self.slabs.tally_steps(self._slots),
                "project": steps,
            }
        recorded_stages = list[Step]()
        for slot, (_, page) in enumerate(placed):
            if page.slots is not None:
                cull_kernel = self._kernels.cull_slots(page, projection=self.image.projection)
                cull = (self._frame_uniform, keys, splats[-1], self._slots, slot, page)
                recorded_stages.append(cull_kernel.step(*cull))
            kernel = self._kernels.project(
                page, projection=self.image.projection, records=self._records, eyes=self.image.eyes
            )
            recorded_stages.append(kernel.step((*outputs, *digits), self._slots, slot, page))
        if normals is not None:
            for slot, (_, page) in enumerate(placed):
                normals_kernel = self._kernels.normals(page)
                recorded_stages.append(normals_kernel.step(keys, normals, self._slots, slot, page))
        return {"project": recorded_stages}

    def _first_digits(self) -> tuple[Buffer, ...]:
        """Return the histograms of the depth sort, if projection counts the keys' first digits."""
        if self.slabs is not None or not self._kernels.counts_keys:
            return ()
        digits = self._kernels.sort.histograms(self._gaussians, KEY_BITS)
        self.buffer_clears.append((digits[0], 0, None))
        return digits

    def _sort_by_depth(
        self, columns: tuple[Columns, Columns], low_keys: Buffer, digits: tuple[Buffer, ...]
    ) -> tuple[list[Step], Buffer]:
        """Return the dispatches of the depth sort, and the buffer of Gaussians, nearest first."""
        n, origins = self._gaussians, None
        if self.slabs is not None:
            origins = self.slabs.origins
        elif self._origins is not None:
            origins = self._storage("origins", 4 * n)
            self._device.write(origins, self._origins)
        spare_keys = (
            self._storage("keys of Gaussians c", 4 * n)
            if self._rasterisation.sort == "deep"
            else None
        )
        return self._kernels.order.steps(
            n, self._counts, columns, low_keys, origins, spare_keys, has_histogram=digits
        )

    def draw(
        self,
        placed: Sequence[PlacedPage],
        band: Band,
        background: Float[np.ndarray, "3"],
        *,
        meshes: Sequence[PlacedMesh] = (),
        fetch: bool = True,
        only: Sequence[str] | None = None,
        right: Camera | None = None,
    ) -> CountsAndImages:
        """Draw a frame, if needed in depth slabs, and wait for its GPU counters and images.

        Arguments, results and errors are those of :meth:`submit` and :meth:`collect`. Images of a
        left and a ``right`` eye are side by side; of their counters the larger is returned.
        """
        if right is not None:
            eyes = band, replace(band, full_camera=right)

            def draw_eye(eye: int, only: list[str]) -> CountsAndImages:
                submit = partial(self.submit, placed, eyes[eye].camera, background, meshes=meshes)
                submit(only=only, band=eyes[eye], right=right)
                return self.collect()

            return draw_eyes(self.stages, draw_eye)

        def run(only: Sequence[str] | None, state: SlabState) -> CountsAndImages:
            is_last = not (state.continues or (state.weighted and self._layers is not None))
            is_fetched = fetch and is_last
            self.submit(
                placed,
                band.camera,
                background,
                meshes=meshes,
                only=only,
                fetch=is_fetched,
                band=band,
                state=state,
            )
            return self.collect(fetch=is_fetched, state=state)

        return draw_parts(list(only or self.stages), run, self.weighted_slabs, self.slabs)

    def visible(self, placed: Sequence[PlacedPage], camera: Camera) -> int | None:
        """Return the number of splats in view; None if sets are blended by weighted sums."""
        if self._weighted_part is not None or not placed:
            return None
        only = ("project", "sort")
        counts, _ = self.draw(placed, Band.of(camera), np.zeros(3), fetch=False, only=only)
        return int(counts[Counts.VISIBLE])

    def submit(
        self,
        placed: Sequence[PlacedPage],
        camera: Camera,
        background: Float[np.ndarray, "3"],
        *,
        meshes: Sequence[PlacedMesh] = (),
        only: Sequence[str] | None = None,
        clock: StageClock | None = None,
        fetch: bool = True,
        staging: StagingBuffers | None = None,
        band: Band | None = None,
        state: SlabState | None = None,
        right: Camera | None = None,
    ) -> None:
        """Write the uniform buffers of a frame, and submit its GPU commands.

        Args:
            placed: The pages of the plan with their present sets.
            camera: The camera, with the image size of the plan; that of the band, if any.
            background: Red, green, blue of the background, multiplied by its alpha.
            meshes: The meshes of the plan with their present transforms.
            only: Stages to run; all if None.
            clock: Measures the GPU time of each stage.
            fetch: Whether :meth:`collect` will read images, too.
            staging: From :meth:`counts_staging` or :meth:`readback`: receives the counts, or counts
                and images, in place of :meth:`collect`.
            band: The rows of a larger image that the plan draws, or None.
            state: The slab of depth that is drawn, or None.
            right: The camera of the right eye of a pair, or None.
        """
        band, state = band or Band.of(camera), state or SlabState()
        device = self._device
        # Step 1: write what changes from frame to frame. The uniforms of depths and normals have no
        # background.
        if self._weighted_part is not None:
            self._weighted_part.write(weighted_pages(placed), camera)
        placed = sorted_pages(placed)
        for buffer, color in ((self._frame_uniform, background), (self._black_frame, np.zeros(3))):
            uniform = frame_uniform(band.full_camera, color, first_row=band.first, rows=band.rows)
            device.write(buffer, state.write_uniform(uniform))
        write_pages(device, placed, camera, self._slots, right)
        if self._meshes is not None:
            device.write(self._mesh_rays, mesh_rays(camera))
        for slot, mesh in enumerate(meshes):
            device.write(self._mesh_slots, mesh_uniform(mesh, camera), slot * MESH_UNIFORM.itemsize)
        # Step 2: clear what shaders add to.
        encoder = device.raw.create_command_encoder(label="frame")
        if clock is not None:
            clock.begin()
        # Later slabs of depth are blended among the cells that were drawn before the first.
        reuses_cells = (
            self._weighted_part and only and set(only).isdisjoint(self._weighted_part.stages)
        )
        cell_clears = (
            self._weighted_part.buffer_clears if self._weighted_part and reuses_cells else []
        )
        for clear in [entry for entry in self.buffer_clears if entry not in cell_clears]:
            encoder.clear_buffer(*clear)
        # Step 3: encode meshes, whose depths hide splats, then the compute stages, then quads.
        if self._meshes is not None and (only is None or "meshes" in only):
            self._meshes.encode(
                encoder, background, clock.timestamp_writes("meshes") if clock else None
            )
        for name, steps in self.stages.items():
            if only is None or name in only:
                run(encoder, steps, name, clock.timestamp_writes(name) if clock else None)
        if self._quads_step is not None:
            self._quads_step.encode(
                encoder, background, clock.timestamp_writes("quads") if clock else None
            )
        if clock is not None:
            clock.encode(encoder)
        # Step 4: copy what the host reads, and submit all at once.
        (staging or self._readback.staging).encode(encoder, None if fetch else self._counters)
        device.submit(encoder)

    def counts_staging(self) -> StagingBuffers:
        """Return a new staging buffer through which a frame's GPU counters are read."""
        return StagingBuffers(self._device, self._counters)

    def readback(self) -> FrameReadback:
        """Return a new readback of a frame's GPU counters and images."""
        return FrameReadback(
            self._device, self._kernels, self._counters, self.images, self.image.size, self._origins
        )

    def collect(self, *, fetch: bool = True, state: SlabState | None = None) -> CountsAndImages:
        """Wait for the GPU to finish a frame; return its counters and images of 32-bit words.

        Errors are those of :class:`FrameReadback`. Counters of weighted sums that are not drawn in
        slabs are added to those of the nearest slab.

        Args:
            fetch: Whether images are read, as in :meth:`submit`.
            state: The slab of depth that was drawn, or None.
        """
        counted: CountedItems = "all"
        if state is not None and state.weighted:
            counted = "cells"
        elif state is not None and (state.resumes or self.weighted_slabs is not None):
            counted = "splats"
        return self._readback.collect(fetch=fetch, counted=counted)
