"""A generator's frames, computed in a thread of their own while the frame before is drawn."""

__all__ = ["FrameDelta", "Inference"]

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, final

import numpy as np
from jaxtyping import Float, Shaped

from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.runtime.errors import SceneInvalid

if TYPE_CHECKING:
    from gsgen.runtime.scene.camera import Camera
    from gsgen.sdk.binding import FrameSession

_COMPARED = 1 << 16  # elements at a time: a difference is mostly found in the first of them


@final
@dataclass(frozen=True, slots=True, eq=False)
class FrameDelta:
    """What a frame has that the one before had not.

    Attributes:
        rows: The packed rows, of which ``count`` hold; None where they are as before.
        appearance: The same of the appearance.
        cells: All cells; None where they are as before, or where there are none.
        count: How many rows are live.
        seconds: What computing took; 0 where nothing had to be computed.
    """

    rows: Float[np.ndarray, "n 10"] | None
    appearance: Float[np.ndarray, "n c"] | None
    cells: Float[np.ndarray, "c 10"] | None
    count: int
    seconds: float = 0.0


@final
class Inference:
    """A generator's session, and copies of the outputs that are being drawn.

    ONNX Runtime releases Python's lock while it computes, so that drawing goes on meanwhile. All
    its calls come from one thread: a CUDA graph is replayed by the thread that recorded it.

    An output is kept twice: as it is drawn, and as the next frame has it. One that a frame
    leaves as it was, in its live rows, bit by bit, is neither copied nor passed on; and nothing is
    computed where no input has changed that the manifest says any output depends on.

    Args:
        path: The model.
        provider: What ONNX Runtime runs it on.
        sizes: Symbol → size of a dimension that the model leaves open.

    Attributes:
        session: What computes; :meth:`start` alone may run it.
        manifest: What the model declares.

    Raises:
        SceneInvalid: The model is no generator, or declares no Gaussians.
        GsgenError: Whatever ``FrameSession`` raises.
    """

    def __init__(
        self, path: Path, provider: str, sizes: Mapping[str, int] | None = None
    ) -> None:
        from gsgen.sdk.binding import FrameSession, Stop

        self._stop = Stop()
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="gsgen inference")
        try:
            opened = self._worker.submit(
                FrameSession, path, provider=provider, sizes=sizes, stop=self._stop
            ).result()
        except BaseException:
            self.interrupt()  # it may never end by itself
            self._worker.shutdown()
            raise
        self.session: FrameSession = opened
        try:
            self.manifest = _generator(path, opened)
        except SceneInvalid:
            self.close()
            raise
        outputs = self.manifest.outputs
        assert outputs.gaussians is not None
        assert outputs.appearance is not None
        self._names = [outputs.gaussians.name, outputs.appearance.name]
        if outputs.cells is not None:
            self._names.append(outputs.cells.name)
        self._inert = frozenset(
            spec.name
            for spec in self.manifest.inputs
            if not self.manifest.depends_on.get(spec.role, True)
        )
        self._forget()

    def start(
        self, camera: "Camera | None", values: Mapping[str, object]
    ) -> "Future[FrameDelta]":
        """Begin to compute a frame, once those that were begun before are done.

        Args:
            camera: Whose frame it is; None leaves what the model knows of a camera as it is.
            values: Tensor name or role → value; what is not named keeps its value.

        Raises:
            SessionClosed: :meth:`close` was called.
        """
        if self.session.closed:
            from gsgen.sdk.binding import SessionClosed

            raise SessionClosed("the session was closed", where=str(self.session.path))
        self._stop.reset()
        return self._worker.submit(self._compute, camera, values)

    def interrupt(self) -> None:
        """End what was begun, which fails; another frame can be begun after."""
        self._stop.now()

    def close(self) -> None:
        """End what was begun, and release the session; doing it twice does no harm."""
        self.interrupt()
        self._worker.shutdown()
        self.session.close()

    def _forget(self) -> None:
        """Let the next frame be new as a whole."""
        self._kept = tuple(_Kept() for _ in self._names)
        self._count = -1

    def _compute(self, camera: "Camera | None", values: Mapping[str, object]) -> FrameDelta:
        started = perf_counter()
        try:
            changed = self.session.update(values, camera=camera)
            if self._count >= 0 and changed <= self._inert:
                return FrameDelta(None, None, None, self._count)
            frame = self.session.run()
            self._count = frame.count
            live = (self._count, self._count, None)  # cells have no count of their own
            rows, appearance, *cells = (
                previous.take(frame[name], live_rows)
                for previous, name, live_rows in zip(
                    self._kept, self._names, live, strict=False
                )
            )
        except BaseException:
            self._forget()
            raise
        cell = cells[0] if cells else None
        return FrameDelta(rows, appearance, cell, self._count, perf_counter() - started)


def _generator(path: Path, session: "FrameSession") -> GeneratorManifest:
    manifest = session.manifest
    if not isinstance(manifest, GeneratorManifest):
        found_kind = f"is a {manifest.kind}" if manifest else "has no manifest"
        hint = "`gsgen inspect --emit-manifest` derives a manifest from names and shapes."
        if manifest and manifest.kind == "post-process":
            hint = "It works on images: `--post` runs it on what the scenes give."
        raise SceneInvalid(
            f"{found_kind}, wanted a gaussian-generator", where=str(path), hint=hint
        )
    if manifest.outputs.gaussians is None or manifest.outputs.appearance is None:
        raise SceneInvalid("declares no gaussians or no appearance", where=str(path))
    return manifest


@final
class _Kept:
    """An output as it is drawn, and a place for the next one."""

    def __init__(self) -> None:
        self._shown: np.ndarray | None = None
        self._spare: np.ndarray | None = None
        self._live = 0

    def take(
        self, array: Float[np.ndarray, "n c"], live_rows: int | None
    ) -> np.ndarray | None:
        """Return a copy that lasts until the call after the next, or None if nothing changed.

        Args:
            array: The output.
            live_rows: How many of its first rows matter; None for all.
        """
        old, live = self._shown, len(array) if live_rows is None else live_rows
        if old is not None and live <= self._live and _same(old[:live], array[:live]):
            return None
        new = np.zeros_like(array) if self._spare is None else self._spare
        new[:live] = array[:live]
        self._shown, self._spare, self._live = new, old, live
        return new


def _same(a: Shaped[np.ndarray, "n c"], b: Shaped[np.ndarray, "n c"]) -> bool:
    """Say whether two arrays are the same bit by bit, stopping where they are not."""
    bits = np.dtype(f"u{a.itemsize}")
    a_bits, b_bits = (
        np.ascontiguousarray(array).reshape(-1).view(bits) for array in (a, b)
    )
    return all(
        np.array_equal(a_bits[start : start + _COMPARED], b_bits[start : start + _COMPARED])
        for start in range(0, len(a_bits), _COMPARED)
    )
