"""The session that computes a model's frames, on whichever provider there is."""

__all__ = ["FrameSession"]

import atexit
import os
import threading
import warnings
import weakref
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import Any, Self

import numpy as np

from gsgen.contract.errors import UnknownName
from gsgen.contract.spec.manifest import Manifest
from gsgen.sdk.binding.bound_session import failed
from gsgen.sdk.binding.buffers import Buffer
from gsgen.sdk.binding.camera_inputs import Camera, camera_values
from gsgen.sdk.binding.frame import Frame
from gsgen.sdk.binding.input_binding import InputBinding
from gsgen.sdk.binding.input_names import Names
from gsgen.sdk.binding.model_facts import read_sources
from gsgen.sdk.binding.providers.cancellation import Stop
from gsgen.sdk.binding.providers.errors import (
    CaptureOff,
    FrameGone,
    InputInvalid,
    NodesOnCpu,
    SessionClosed,
)
from gsgen.sdk.binding.providers.node_placement import CPU, Node
from gsgen.sdk.binding.providers.selection import Choice, Provider, SessionOptions, choose
from gsgen.sdk.binding.warm_up import Ready, get_ready

# All sessions on WebGPU share one device, which is not made for several threads.
_ON_WEBGPU = threading.RLock()
_alive: "weakref.WeakSet[FrameSession]" = weakref.WeakSet()


class FrameSession:
    """A model that is ready to compute frames: buffers are bound, commands are captured.

    ::

        with FrameSession("model.onnx") as session:
            frame = session.run({"time": 0.3}, camera=camera)
            gaussians = frame.gaussians()

    Inputs keep their value from frame to frame; at first they have the manifest's defaults. One
    session may be used from several threads: frames are computed one after the other.

    Attributes:
        path: The model.
        manifest: What its tensors mean; None where nobody says.
        provider: ``cpu``, ``webgpu`` or ``cuda``.
        reason: Why it is this provider.
        device: What computes, in words.
        captured: Frames are replayed from a capture that was found right at warm-up.
        cause: Why they are not; empty where they are, or where nobody asked.
        nodes: Where ONNX Runtime put each node.
    """

    def __init__(
        self,
        model: str | os.PathLike[str],
        *,
        provider: str = "auto",
        capture: bool = True,
        sizes: Mapping[str, int] | None = None,
        manifest: Manifest | None = None,
        threads: int = 0,
        stop: Stop | None = None,
    ) -> None:
        """Open the model, bind its buffers and run it; nothing is left to do in the first frame.

        Args:
            model: The ONNX file. Validate it before, if it is not your own.
            provider: ``cpu``, ``webgpu``, ``cuda``, or ``auto`` for the fastest that is here.
            capture: Record the GPU's commands once and replay them, where that can be done.
            sizes: Symbol → size of a dimension that the model leaves open; ``NAME[AXIS]`` where
                it has no symbol.
            manifest: Stands in for the embedded one.
            threads: Threads of the CPU provider; 0 lets ONNX Runtime decide.
            stop: Ends runs of a model that takes too long, those of this call, too.

        Raises:
            ModelUnreadable: The file is no ONNX model.
            ManifestInvalid: The embedded manifest cannot be read.
            ProviderUnavailable: The provider asked for cannot be had here.
            SizeUnknown: A dimension has no size.
            UnknownName: A provider or an open dimension of that name does not exist.
            RunFailed: ONNX Runtime cannot load or run the model.
        """
        self.path = Path(model)
        self._number = -1
        self._sources = sources = read_sources(self.path, manifest)
        known, choice = sources.sizes(sizes or {}), choose(provider)
        capture = capture and choice.provider != "cpu"
        opening = SessionOptions(choice, capture, known, threads, stop)
        with _lock_of(choice):
            ready = get_ready(sources, opening)
        self._ready: Ready | None = ready
        self._lock = _lock_of(ready.choice)
        self._names = Names.of(ready.ports.values(), str(self.path))
        self.manifest, self.nodes = sources.manifest, ready.nodes
        self.provider: Provider = ready.choice.provider
        self.reason, self.device = ready.choice.reason, ready.choice.device
        self.captured, self.cause = ready.captured, ready.cause
        _alive.add(self)
        self._warn()

    def _warn(self) -> None:
        if self.cause:
            text = f"{self.path.name} runs without capture on {self.provider}: {self.cause}"
            warnings.warn(text, CaptureOff, stacklevel=3)
        left = self.left_on_cpu
        if left:
            named = ", ".join(dict.fromkeys(node.operator for node in left))
            count = f"{len(left)} of {len(self.nodes)} nodes"
            text = f"{self.path.name} on {self.provider}: {count} run on the CPU ({named})"
            warnings.warn(text, NodesOnCpu, stacklevel=3)

    # ---- What is in it

    @property
    def left_on_cpu(self) -> tuple[Node, ...]:
        """Nodes that run on the CPU though the session is on a GPU."""
        if self.provider == "cpu":
            return ()
        return tuple(node for node in self.nodes if node.provider == CPU)

    @property
    def closed(self) -> bool:
        """Whether everything was released."""
        return self._ready is None

    @property
    def inputs(self) -> Mapping[str, InputBinding]:
        """Input name → its dtype, shape and role."""
        return MappingProxyType(self._open_one().ports)

    @property
    def outputs(self) -> Mapping[str, Buffer]:
        """Output name → the buffer that it stays in, with its dtype and shape."""
        return MappingProxyType(self._open_one().bound.outputs)

    def samples(self) -> list[dict[str, np.ndarray]]:
        """Return two sets of tensors that differ, to :meth:`write` and try the model with."""
        return [dict(one) for one in self._sources.probes(self._open_one().ports.values())]

    # ---- Every frame

    def run(
        self,
        values: Mapping[str, object] | None = None,
        *,
        camera: Camera | None = None,
        copy: bool = False,
    ) -> Frame:
        """Update inputs and compute a frame.

        Args:
            values: As in :meth:`update`.
            camera: As in :meth:`update`.
            copy: Give the frame arrays of its own, which outlive the next run. Threads that share
                a session need this.

        Raises:
            InputInvalid: A value does not fit; nothing was updated.
            UnknownName: There is no such input or role.
            RunFailed: ONNX Runtime failed, such as when a device is lost.
            SessionClosed: The session was closed.
        """
        with self._lock:
            if values or camera is not None:
                self.update(values, camera=camera)
            ready = self._open_one()
            self._number += (
                1  # before it runs: a run that fails spoils the frame before, too
            )
            try:
                ready.bound.run()
                kept = ready.bound.copies() if copy else None
            except Exception as error:
                raise failed(error) from error
            return Frame(self, self._number, kept)

    def update(
        self,
        values: Mapping[str, object] | None = None,
        *,
        camera: Camera | None = None,
    ) -> frozenset[str]:
        """Update inputs in place, for the next run; all of them or, if one does not fit, none.

        Args:
            values: Tensor name or role → value. A number fills an input of one element. Matrices
                are given as in mathematics and laid out as the manifest declares.
            camera: An object with ``view`` and ``projection`` or with ``view`` and intrinsics, or
                the pair of matrices; it updates whatever the model wants to know of a camera.

        Returns:
            Names of the tensors that held another value before.

        Raises:
            InputInvalid: A value does not fit.
            UnknownName: There is no such input or role.
            SessionClosed: The session was closed.
        """
        with self._lock:
            ready = self._open_one()
            given = self._of_camera(camera) if camera is not None else {}
            for key, value in (values or {}).items():
                given[self._names.find(key)] = value
            tensors = {
                name: ready.ports[name].tensor(value) for name, value in given.items()
            }
            return ready.bound.write(tensors)

    def write(self, tensors: Mapping[str, np.ndarray]) -> None:
        """Copy tensors into inputs as they are, by name: matrices laid out already, any range.

        Raises:
            InputInvalid: A tensor has another shape, or a dtype that cannot be converted.
            UnknownName: There is no such input.
            SessionClosed: The session was closed.
        """
        with self._lock:
            ready = self._open_one()
            made = {}
            for name, value in tensors.items():
                if name not in ready.ports:
                    raise UnknownName.among("input", name, ready.ports, str(self.path))
                made[name] = ready.ports[name].fitting(value)
            ready.bound.write(made)

    def _of_camera(self, camera: Camera) -> dict[str, object]:
        if self.manifest is None:
            what = "no manifest says which inputs are the camera's"
            hint = "Embed one (`gsgen inspect --emit-manifest`), or pass manifest=."
            raise InputInvalid(what, where=str(self.path), hint=hint)
        values = camera_values(camera)
        ports = self._open_one().ports.values()
        return {port.name: values[port.role] for port in ports if port.role in values}

    # ---- What frames read

    def read(self, name: str, number: int) -> np.ndarray:
        """Return an output of frame ``number``; see :class:`gsgen.sdk.binding.Frame`."""
        with self.still(number):
            self._output(name)
            try:
                return self._open_one().bound.read(name)
            except (
                Exception
            ) as error:  # ONNX Runtime's errors share no base class of their own
                raise failed(error) from error

    def handle(self, name: str, number: int) -> Any:
        """Return ONNX Runtime's handle of an output of frame ``number``."""
        with self.still(number):
            return self._output(name).value

    @contextmanager
    def still(self, number: int) -> Iterator[None]:
        """Keep other threads from computing while frame ``number`` is read.

        Raises:
            FrameGone: There is a newer frame already.
            SessionClosed: The session was closed.
        """
        with self._lock:
            self._open_one()
            if number != self._number:
                what = f"frame {number} was overwritten by frame {self._number}"
                hint = "Read a frame before the next run, or run(…, copy=True)."
                raise FrameGone(what, where=str(self.path), hint=hint)
            yield

    def _output(self, name: str) -> Buffer:
        outputs = self._open_one().bound.outputs
        if name not in outputs:
            raise UnknownName.among("output", name, outputs, str(self.path))
        return outputs[name]

    # ---- The end

    def close(self) -> None:
        """Release the session, its buffers and its capture; doing it twice does no harm."""
        with self._lock:
            if self._ready is not None:
                self._ready.bound.close()
                self._ready = None

    def __enter__(self) -> Self:
        self._open_one()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        state = "closed" if self.closed else "captured" if self.captured else "not captured"
        return f"<FrameSession {self.path.name} on {self.provider}, {state}>"

    def _open_one(self) -> Ready:
        if self._ready is None:
            what = "the session was closed"
            raise SessionClosed(what, where=str(self.path), hint="Open a new FrameSession.")
        return self._ready


def _lock_of(choice: Choice) -> AbstractContextManager[object]:
    return _ON_WEBGPU if choice.provider == "webgpu" else threading.RLock()


@atexit.register
def _close_all() -> None:
    """Release devices while the interpreter is whole: drivers may crash at its very end."""
    for session in list(_alive):
        session.close()
