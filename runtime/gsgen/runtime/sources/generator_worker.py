"""Computes the frames of an ONNX generator in a thread while other frames are drawn."""

__all__ = ["FrameDelta", "GeneratorWorker"]

from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, final

import numpy as np
from jaxtyping import Float, Shaped

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.contract.spec.reader_needs import REGISTERED_EXTENSIONS
from gsgen.runtime.errors import SceneInvalid

if TYPE_CHECKING:
    from gsgen.runtime.scene.camera import Camera
    from gsgen.sdk.binding import FrameSession
    from gsgen.sdk.binding.confined.models import ConfinedModels

_BLOCK_ELEMENTS = 1 << 16  # elements compared at a time: most often the first block differs


@final
@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FrameDelta:
    """The outputs of an ONNX generator that differ from those of the previous frame.

    Attributes:
        rows: The packed rows, of which ``count`` are live; None if unchanged.
        appearance: The appearance rows; None if unchanged.
        cells: All cells; None if unchanged, or without cells.
        count: Number of live rows.
        seconds: Seconds of the computation; 0 if no input changed.
    """

    rows: Float[np.ndarray, "n 10"] | None = None
    appearance: Float[np.ndarray, "n c"] | None = None
    cells: Float[np.ndarray, "c 10"] | None = None
    count: int
    seconds: float = 0.0


@final
class GeneratorWorker:
    """Runs an ONNX generator in a thread of its own, and keeps copies of the drawn outputs.

    ONNX Runtime releases Python's lock while it computes, so drawing continues. All its calls come
    from one thread: a CUDA graph must be replayed by the thread that recorded it.

    Each output has two buffers: the drawn one, and one for the next frame; and one for each earlier
    frame that is held (:meth:`hold_frames`). An output whose live
    rows are unchanged, bit by bit, is neither copied nor passed on. The model does not run if no
    input has changed that an output depends on, according to the manifest.

    Attributes:
        session: The session, which only :meth:`start` may run.
        manifest: Manifest of the model.
    """

    def __init__(
        self,
        path: Path,
        provider: str,
        sizes: Mapping[str, int] | None = None,
        confined: "ConfinedModels | None" = None,
    ) -> None:
        from gsgen.sdk.binding import FrameSession, Stop

        self._stop = Stop()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="gsgen inference")
        try:
            opened_session = self._worker.submit(
                FrameSession,
                path,
                provider=provider,
                sizes=sizes,
                stop=self._stop,
                confined=confined or False,
            ).result()
        except BaseException:
            self.interrupt()  # a model may run for ever
            self._worker.shutdown()
            raise
        self.session: FrameSession = opened_session
        try:
            self.manifest = _generator_manifest(path, opened_session)
        except SceneInvalid:
            self.close()
            raise
        outputs = self.manifest.outputs
        assert outputs.gaussians is not None
        assert outputs.appearance is not None
        self._names = [outputs.gaussians.name, outputs.appearance.name]
        if outputs.cells is not None:
            self._names.append(outputs.cells.name)
        self._unused_inputs = frozenset(
            spec.name for spec in self.manifest.inputs if not self.manifest.depends(spec)
        )
        self._held_frames = 0
        self._discard_copies()

    def start(self, camera: "Camera | None", values: Mapping[str, object]) -> "Future[FrameDelta]":
        """Begin to compute a frame of the ONNX generator, after the pending ones.

        Args:
            camera: Camera of the frame; None leaves the camera inputs unchanged.
            values: Tensor name or role → value; absent inputs keep their value.
        """
        if self.session.closed:
            from gsgen.sdk.binding import SessionClosed

            message = "the session was closed, expected an open one"
            raise SessionClosed(message, where=str(self.session.path))
        self._stop.reset()
        return self._worker.submit(self._compute_delta, camera, values)

    def hold_frames(self, frames: int) -> None:
        """Keep the outputs of some frames before the drawn one unchanged, from the next run on."""
        self._held_frames = frames

    def interrupt(self) -> None:
        """Stop the ONNX runs of all requested frames, which then fail."""
        self._stop.now()

    def close(self) -> None:
        """Stop all ONNX runs of frames, and release the session; a second call has no effect."""
        self.interrupt()
        self._worker.shutdown()
        self.session.close()

    def _discard_copies(self) -> None:
        """Discard the copied outputs, so that all outputs of the next frame count as changed."""
        self._buffers = tuple(_OutputBuffer() for _ in self._names)
        self._splat_count = -1

    def _compute_delta(self, camera: "Camera | None", values: Mapping[str, object]) -> FrameDelta:
        started = perf_counter()
        try:
            changed = self.session.update(values, camera=camera)
            if self._splat_count >= 0 and changed <= self._unused_inputs:
                return FrameDelta(count=self._splat_count)
            frame = self.session.run()
            self._splat_count = frame.count
            live_count = (
                self._splat_count,
                self._splat_count,
                None,
            )  # cells have no count of their own
            constant = self.session.constant_outputs
            rows, appearance, *cells = (
                buffer.take(
                    frame[name], live_rows, is_constant=name in constant, retained=self._held_frames
                )
                for buffer, name, live_rows in zip(
                    self._buffers, self._names, live_count, strict=False
                )
            )
        except BaseException:
            self._discard_copies()
            raise
        return FrameDelta(
            rows=rows,
            appearance=appearance,
            cells=cells[0] if cells else None,
            count=self._splat_count,
            seconds=perf_counter() - started,
        )


def _generator_manifest(path: Path, session: "FrameSession") -> GeneratorManifest:
    manifest = session.manifest
    if not isinstance(manifest, GeneratorManifest):
        kind = f"is a {manifest.kind}" if manifest else "has no manifest"
        hint = "`gsgen inspect --emit-manifest` derives a manifest from names and shapes."
        if manifest and manifest.kind == "post-process":
            hint = "Run post-process models on the drawn frames with `--post`."
        raise SceneInvalid(f"{kind}, expected a gaussian-generator", where=str(path), hint=hint)
    unknown_extensions = [
        name for name in manifest.extensions_required if name not in REGISTERED_EXTENSIONS
    ]
    if unknown_extensions:
        hint = "Ask the author of the model for a copy without them."
        message = (
            f"requires extensions that this runtime does not know: {', '.join(unknown_extensions)}"
        )
        raise SceneInvalid(message, where=str(path), hint=hint)
    if manifest.outputs.gaussians is None or manifest.outputs.appearance is None:
        raise SceneInvalid(
            "the model declares no gaussians output or no appearance output, expected both",
            where=str(path),
        )
    return manifest


@final
class _OutputBuffer:
    """Copies of a model output: one is drawn while the next frame fills another."""

    def __init__(self) -> None:
        self._current_row_copy: np.ndarray | None = None
        self._older_row_copies: deque[np.ndarray] = (
            deque()
        )  # copies before the shown one, oldest first
        self._live_rows = 0

    def take(
        self,
        array: Float[np.ndarray, "n c"],
        live_rows: int | None,
        *,
        is_constant: bool = False,
        retained: int = 0,
    ) -> np.ndarray | None:
        """Copy a model output without padding rows; return None if the last copy has the same rows.

        The copy stays valid until the call after the next, and for ``retained`` further calls. A
        constant output is not compared.
        """
        old_array, live_count = (
            self._current_row_copy,
            len(array) if live_rows is None else live_rows,
        )
        if (
            old_array is not None
            and live_count <= self._live_rows
            and (is_constant or _are_bits_equal(old_array[:live_count], array[:live_count]))
        ):
            return None
        has_free_copy = len(self._older_row_copies) > retained
        new_array = self._older_row_copies.popleft() if has_free_copy else np.zeros_like(array)
        new_array[:live_count] = array[:live_count]
        if old_array is not None:
            self._older_row_copies.append(old_array)
        self._current_row_copy, self._live_rows = new_array, live_count
        return new_array


def _are_bits_equal(a: Shaped[np.ndarray, "n c"], b: Shaped[np.ndarray, "n c"]) -> bool:
    """Return whether two arrays have the same bits, stopping at the first difference."""
    bits = np.dtype(f"u{a.itemsize}")
    left_bits, right_bits = (np.ascontiguousarray(array).reshape(-1).view(bits) for array in (a, b))
    return all(
        np.array_equal(
            left_bits[start : start + _BLOCK_ELEMENTS], right_bits[start : start + _BLOCK_ELEMENTS]
        )
        for start in range(0, len(left_bits), _BLOCK_ELEMENTS)
    )
