"""The session that computes a model's frames on the CPU, WebGPU or CUDA."""

__all__ = ["FrameSession"]

import atexit
import os
import threading
import warnings
import weakref
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from gsgen.contract.errors import UnknownName
from gsgen.contract.model.fetched_inputs import local_file
from gsgen.contract.spec.manifest import Manifest
from gsgen.sdk.binding.bound.bound_session import BoundSession, translate_error
from gsgen.sdk.binding.bound.input_binding import InputBinding
from gsgen.sdk.binding.bound.model_facts import read_model_facts
from gsgen.sdk.binding.bound.scene_pass import ScenePassSession
from gsgen.sdk.binding.bound.warm_up import WarmSession, lock_of, open_warm
from gsgen.sdk.binding.camera_inputs import Camera, camera_values
from gsgen.sdk.binding.frame import Frame
from gsgen.sdk.binding.input_names import InputNames
from gsgen.sdk.binding.providers.buffers import Buffer
from gsgen.sdk.binding.providers.cancellation import Stop
from gsgen.sdk.binding.providers.errors import (
    CaptureOff,
    FrameExpired,
    InputInvalid,
    NodesOnCpu,
    SessionClosed,
)
from gsgen.sdk.binding.providers.node_placement import CPU, Node
from gsgen.sdk.binding.providers.selection import Provider

if TYPE_CHECKING:
    from gsgen.sdk.binding.confined.models import ConfinedModels
    from gsgen.sdk.binding.confined.session import ConfinedSession

_open_sessions: "weakref.WeakSet[FrameSession]" = weakref.WeakSet()


class FrameSession:
    """A loaded model that computes frames, with bound buffers and optional graph capture.

    ::

        with FrameSession("model.onnx") as session:
            frame = session.run({"time": 0.3}, camera=camera)
            gaussians = frame.gaussians()

    Inputs keep their value from frame to frame; initially they have the manifest's defaults.
    Several threads may use one session: frames are computed one after the other.

    Attributes:
        path: The model file.
        manifest: The meaning of its tensors; None without a manifest.
        provider: ``cpu``, ``webgpu`` or ``cuda``.
        reason: The reason for this provider.
        device: The device that computes, as text.
        captured: Frames are replayed from a capture that the warm-up has verified.
        cause: The reason why they are not; empty if they are, or if capture is off.
        nodes: The execution provider of each node.
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
        confined: "ConfinedModels | bool" = False,
    ) -> None:
        """Open a model, bind its buffers, and run it once, so that the first frame is fast.

        Args:
            model: The ONNX file, or its address. Confine it if it is not your own.
            provider: ``cpu``, ``webgpu``, ``cuda``, or ``auto`` for the fastest available.
            capture: Record the GPU's commands once and replay them, if the model allows it.
            sizes: Symbol → size of an open dimension; ``NAME[AXIS]`` if it has no symbol.
            manifest: Replaces the embedded manifest.
            threads: Threads of the CPU provider; 0 lets ONNX Runtime decide.
            stop: Ends runs that take too long, including those of this constructor.
            confined: Run the model in a child process with limits on time, memory, files and
                network: one of its own (True), or one that several models share.

        Raises:
            HostProcessFailed: The machine has no memory or no process for a confined model.
            ModelUnreadable: The file is not an ONNX model.
            InputUnreadable: The file at an address cannot be had.
            ManifestInvalid: The embedded manifest cannot be read.
            ProviderUnavailable: The requested provider is not available.
            SizeUnknown: A dimension has no size.
            UnknownName: No provider or open dimension has this name.
            RunFailed: ONNX Runtime cannot load or run the model.
        """
        self.path = local_file(model)
        self._number = -1
        self._sources = sources = read_model_facts(self.path, manifest)
        settings: dict[str, Any] = {
            "provider": provider, "capture": capture, "sizes": sizes or {}, "threads": threads,
            "stop": stop,
        }  # fmt: skip
        self._own_process: ConfinedModels | None = None
        self._lock: AbstractContextManager[object] = threading.RLock()
        opened_session: WarmSession | ConfinedSession
        if confined:
            opened_session = self._open_confined(confined, is_embedded=manifest is None, **settings)
            self._bound: BoundSession | ScenePassSession | ConfinedSession | None = opened_session
        else:
            opened_session = open_warm(sources, **settings)
            self._bound, self._lock = opened_session.bound, lock_of(opened_session.choice)
        self._ports = opened_session.ports
        self._names = InputNames.from_bindings(opened_session.ports.values(), str(self.path))
        self.manifest, self.nodes = sources.manifest, opened_session.nodes
        self.provider: Provider = opened_session.provider
        self.reason, self.device = opened_session.reason, opened_session.device
        self.captured, self.cause = opened_session.captured, opened_session.cause
        _open_sessions.add(self)
        self._warn_of_fallbacks()

    def _open_confined(
        self, confined: "ConfinedModels | bool", **settings: Any
    ) -> "ConfinedSession":
        from gsgen.sdk.binding.confined.models import ConfinedModels
        from gsgen.sdk.binding.confined.session import open_confined

        if isinstance(confined, bool):
            has_gpu = settings["provider"] != "cpu"
            self._own_process = confined = ConfinedModels([self.path], has_gpu=has_gpu)
        self._confined = confined  # which would end its processes if it were collected
        try:
            return open_confined(self._sources, confined, **settings)
        except BaseException:
            self._end_own_process()
            raise

    def _end_own_process(self) -> None:
        if self._own_process is not None:
            self._own_process.close()

    def _warn_of_fallbacks(self) -> None:
        if self.cause:
            text = f"{self.path.name} runs without capture on {self.provider}: {self.cause}"
            warnings.warn(text, CaptureOff, stacklevel=3)
        cpu_nodes = self.left_on_cpu
        if cpu_nodes:
            operators = ", ".join(dict.fromkeys(node.operator for node in cpu_nodes))
            count = f"{len(cpu_nodes)} of {len(self.nodes)} nodes"
            text = f"{self.path.name} on {self.provider}: {count} run on the CPU ({operators})"
            warnings.warn(text, NodesOnCpu, stacklevel=3)

    # ---- Properties

    @property
    def left_on_cpu(self) -> tuple[Node, ...]:
        """The graph nodes that run on the CPU although the model's session is on a GPU."""
        if self.provider == "cpu":
            return ()
        return tuple(node for node in self.nodes if node.provider == CPU)

    @property
    def closed(self) -> bool:
        """Whether :meth:`close` was called on the model's session."""
        return self._bound is None

    @property
    def inputs(self) -> Mapping[str, InputBinding]:
        """The inputs of the model by name: dtype, shape and input role."""
        self._require_open_session()
        return MappingProxyType(self._ports)

    @property
    def outputs(self) -> Mapping[str, Buffer]:
        """The outputs of the model by name, as buffers with dtype and shape."""
        return MappingProxyType(self._require_open_session().outputs)

    @property
    def constant_outputs(self) -> frozenset[str]:
        """Names of the outputs that every frame of the model shares, for all inputs."""
        return self._sources.constant_outputs

    def samples(self) -> list[dict[str, np.ndarray]]:
        """Return two different sets of input tensors to test the model with."""
        return [dict(probe) for probe in self._sources.probes(self.inputs.values())]

    # ---- Every frame

    def run(
        self,
        values: Mapping[str, object] | None = None,
        *,
        camera: Camera | None = None,
        copy: bool = False,
    ) -> Frame:
        """Set values of some inputs of the model, and compute a frame.

        Args:
            values: As in :meth:`update`.
            camera: As in :meth:`update`.
            copy: Copy the outputs, so that the frame outlives the next run. Threads that share
                a session need this.

        Raises:
            InputInvalid: A value does not fit; no input was updated.
            UnknownName: No input has this name or role.
            RunFailed: ONNX Runtime failed, such as when a device is lost.
            SessionClosed: The session was closed.
        """
        with self._lock:
            if values or camera is not None:
                self.update(values, camera=camera)
            bound = self._require_open_session()
            self._number += 1  # before the run: a failed run invalidates the last frame, too
            try:
                bound.run()
                copies = bound.copies() if copy else None
            except Exception as error:
                raise translate_error(error) from error
            return Frame(self, self._number, copies)

    def update(
        self, values: Mapping[str, object] | None = None, *, camera: Camera | None = None
    ) -> frozenset[str]:
        """Set model inputs for the next frame; if one value is invalid, no input changes.

        Args:
            values: Tensor name or role → value. A number fills an input of one element. Matrices
                are passed as in mathematics and stored as the manifest declares.
            camera: An object with ``view`` and ``projection`` or with ``view`` and intrinsics, or
                the pair of matrices; it updates every camera input of the model.

        Returns:
            Names of the tensors whose value changed.

        Raises:
            InputInvalid: A value does not fit.
            UnknownName: No input has this name or role.
            SessionClosed: The session was closed.
        """
        with self._lock:
            bound = self._require_open_session()
            updates = self._camera_updates(camera) if camera is not None else {}
            for key, value in (values or {}).items():
                updates[self._names.find(key)] = value
            tensors = {name: self._ports[name].tensor(value) for name, value in updates.items()}
            return bound.write(tensors)

    def write(self, tensors: Mapping[str, np.ndarray]) -> None:
        """Copy tensors unchanged into model inputs, by name; matrices in the model's memory order.

        Raises:
            InputInvalid: A tensor has another shape, or a dtype that cannot be converted.
            UnknownName: No input has this name.
            SessionClosed: The session was closed.
        """
        with self._lock:
            bound = self._require_open_session()
            arrays = {}
            for name, value in tensors.items():
                if name not in self._ports:
                    raise UnknownName.among("input", name, self._ports, str(self.path))
                arrays[name] = self._ports[name].convert_value(value)
            bound.write(arrays)

    def _camera_updates(self, camera: Camera) -> dict[str, object]:
        if self.manifest is None:
            message = "no manifest declares the camera inputs"
            hint = "Embed one (`gsgen inspect --emit-manifest`), or pass manifest=."
            raise InputInvalid(message, where=str(self.path), hint=hint)
        values = camera_values(camera)
        ports = self._ports.values()
        return {port.name: values[port.role] for port in ports if port.role in values}

    # ---- Access for frames

    def read(self, name: str, number: int) -> np.ndarray:
        """Return an output of frame ``number`` as an array; raise if a newer frame replaced it."""
        with self.hold_frame(number):
            self._output(name)
            try:
                return self._require_open_session().read(name)
            except Exception as error:  # ONNX Runtime's errors share no base class of their own
                raise translate_error(error) from error

    def handle(self, name: str, number: int) -> Any:
        """Return the ``OrtValue`` that holds a model output of frame ``number``."""
        with self.hold_frame(number):
            return self._output(name).value

    @contextmanager
    def hold_frame(self, number: int) -> Iterator[None]:
        """Prevent other threads from computing a new frame while frame ``number`` is read.

        Raises:
            FrameExpired: The session has computed a newer frame.
            SessionClosed: The session was closed.
        """
        with self._lock:
            self._require_open_session()
            if number != self._number:
                message = f"frame {number} was overwritten by frame {self._number}"
                hint = "Read a frame before the next run, or run(…, copy=True)."
                raise FrameExpired(message, where=str(self.path), hint=hint)
            yield

    def _output(self, name: str) -> Buffer:
        outputs = self._require_open_session().outputs
        if name not in outputs:
            raise UnknownName.among("output", name, outputs, str(self.path))
        return outputs[name]

    # ---- The end

    def close(self) -> None:
        """Release the model's session, buffers and graph capture; a second call does nothing."""
        with self._lock:
            if self._bound is not None:
                self._bound.close()
                self._bound = None
            self._end_own_process()

    def __enter__(self) -> Self:
        self._require_open_session()
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

    def _require_open_session(self) -> "BoundSession | ScenePassSession | ConfinedSession":
        if self._bound is None:
            message = "the session was closed"
            raise SessionClosed(message, where=str(self.path), hint="Open a new FrameSession.")
        return self._bound


@atexit.register
def _close_all_sessions() -> None:
    """Close all ONNX Runtime sessions before interpreter shutdown, in which drivers may crash."""
    for session in list(_open_sessions):
        session.close()
