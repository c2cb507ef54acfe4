"""The child process of validation level ``live``: runs one model in WebGPU, then exits.

Every frame is computed twice: by a session without capture, then by one that captures its commands
with the first frame and replays them for the others. Both write their outputs to files for the
parent; a crash keeps everything that was written before.
"""

__all__ = ["main"]

import os
import re
import sys
from collections.abc import Callable, Iterator
from dataclasses import astuple
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from gsgen.contract.probing.sandbox_worker import (
    EmitMessage,
    input_reader,
    keep_outputs,
    run_worker,
)
from gsgen.contract.process.limits import DRIVER_BYTES, limit_memory
from gsgen.sdk.binding.bound.bound_session import BoundSession
from gsgen.sdk.binding.providers.errors import ProviderFallback, ProviderUnavailable
from gsgen.sdk.binding.providers.node_placement import error_text, node_placement
from gsgen.sdk.binding.providers.selection import (
    BUFFER_MEMORY,
    ProviderChoice,
    SessionOptions,
    open_session,
)
from gsgen.sdk.binding.providers.webgpu import DRIVER_HINT, AdapterMissing, find_adapter

# The Vulkan loader logs the opened device if VK_LOADER_DEBUG is set.
_OPENED_DEVICE_PATTERN = re.compile(r'Using "([^"]+)" with driver')
_SOFTWARE_ADAPTER = re.compile("llvmpipe|swiftshader|basic render|warp", re.IGNORECASE)


class SourceOpener(Protocol):
    """Protocol of a function that opens a session for a model, with or without graph capture."""

    def __call__(self, model: Path | bytes, *, capture: bool) -> Any: ...


def main(folder: Path) -> int:
    """Run the WebGPU job that ``folder/job.json`` describes, and return the exit code."""
    return run_worker(folder, _run_job)


def _run_job(folder: Path, job: dict[str, Any], emit: EmitMessage) -> int:
    _set_driver_environment(folder)
    try:
        import onnxruntime

        emit("started", version=onnxruntime.__version__)
        onnxruntime.set_default_logger_severity(3)
        opener = _find_provider(emit)
        _try_adapter(opener, folder, emit, half=job["half"])
        limit_memory(job["memory"] + DRIVER_BYTES)
        if job["probes"]:
            _FrameRunner(folder, job, emit, opener).run()
    except AdapterMissing as error:
        emit("unavailable", message=error.message, hint=error.hint)
    except ProviderFallback as error:
        emit("fell-back", message=error.message)
    emit("done")
    return 0


def _set_driver_environment(folder: Path) -> None:
    """Set environment variables for GPU drivers, unless the user already did."""
    default_environment = {
        "ORT_WEBGPU_EP_ALLOW_SOFTWARE_ADAPTER": "1",
        "VK_LOADER_DEBUG": "driver",
        "XDG_RUNTIME_DIR": str(folder),
        # Shaders of the session without capture are those of the other one.
        "MESA_SHADER_CACHE_DIR": str(folder),
    }
    for name, value in default_environment.items():
        os.environ.setdefault(name, value)


def _find_provider(emit: EmitMessage) -> SourceOpener:
    """Report the GPU of the WebGPU provider, and return a function that opens models on it."""
    adapter = find_adapter()
    emit("device", name=adapter.name, version=adapter.version)
    choice = ProviderChoice("webgpu", "requested", adapter, is_requested=True)

    def open_with_adapter(model: Path | bytes, *, capture: bool) -> Any:
        return open_session(model, SessionOptions(choice=choice, capture=capture))

    return open_with_adapter


def _try_adapter(opener: SourceOpener, folder: Path, emit: EmitMessage, *, half: bool) -> None:
    """Run a minimal model in float32 and float16, and report the GPU that ran it."""
    try:
        _run_smallest_model(opener, "float32")
    except ProviderFallback:
        raise
    except Exception as error:  # ONNX Runtime's errors share no base class of their own
        reason = error.message if isinstance(error, ProviderUnavailable) else error_text(error)
        raise AdapterMissing(
            f"there is no usable WebGPU adapter ({reason})", DRIVER_HINT
        ) from error
    log = (folder / "log").read_text("utf-8", errors="replace")
    device_names = _OPENED_DEVICE_PATTERN.findall(log)
    name = device_names[-1] if device_names else ""
    try:
        _run_smallest_model(opener, "float16")
    except Exception as error:
        emit("adapter", name=name, software=bool(_SOFTWARE_ADAPTER.search(name)), half=False)
        if half:
            message = f"the model has float16 tensors, and adapter {name or '?'} no shader-f16"
            raise AdapterMissing(message, "use a newer driver") from error
    else:
        emit("adapter", name=name, software=bool(_SOFTWARE_ADAPTER.search(name)), half=True)


def _run_smallest_model(opener: SourceOpener, dtype: str) -> None:
    from onnx import ModelProto, NodeProto, TensorProto

    kind = TensorProto.FLOAT16 if dtype == "float16" else TensorProto.FLOAT
    model = ModelProto(ir_version=8)
    model.opset_import.add(domain="", version=18)
    model.graph.name = "smallest"
    model.graph.node.append(NodeProto(op_type="Add", input=["x", "x"], output=["y"]))
    for name, values in (("x", model.graph.input), ("y", model.graph.output)):
        tensor = values.add(name=name).type.tensor_type
        tensor.elem_type = kind
        tensor.shape.dim.add(dim_value=4)
    session = opener(model.SerializeToString(), capture=False)
    (result,) = session.run(None, {"x": np.arange(4, dtype=dtype)})
    if result.tolist() != [0, 2, 4, 6]:
        raise RuntimeError(
            f"the WebGPU adapter computes 2 · [0, 1, 2, 3] as {result.tolist()}, expected [0, 2, 4, 6]"
        )


class _FrameRunner:
    """Computes the frames of one model in WebGPU, without graph capture and by replay."""

    def __init__(
        self, folder: Path, job: dict[str, Any], emit: EmitMessage, opener: SourceOpener
    ) -> None:
        self.folder, self.job, self.emit, self.opener = folder, job, emit, opener
        self.known: dict[str, int] = {}

    def run(self) -> None:
        if self._run_phase("plain", self._run_without_graph_capture):
            self._run_phase("captured", self._run_with_graph_capture)

    def _run_phase(self, name: str, run_frames: Callable[[], None]) -> bool:
        """Run a job's frames with or without WebGPU graph capture; return False after an error."""
        self.index = -1
        try:
            run_frames()
        except (ProviderFallback, OSError):  # an error of a file is a fault of this machine
            raise
        except Exception as error:
            self.emit("stopped", phase=name, frame=self.index, message=error_text(error))
            return False
        return True

    def _frames(self, phase: str) -> Iterator[dict[str, np.ndarray]]:
        inputs_of = input_reader(self.folder, self.job)
        for index in range(len(self.job["probes"])):
            self.index = index
            self.emit("begin", phase=phase, probe=index)
            yield inputs_of(index)

    def _emit_frame(self, phase: str, outputs: dict[str, np.ndarray]) -> None:
        sample = keep_outputs(self.folder, outputs, self.known, self.emit, disk=self.job["disk"])
        self.emit("frame", phase=phase, frame=self.index, sample=sample)

    def _run_without_graph_capture(self) -> None:
        session = self.opener(Path(self.job["model"]), capture=False)
        self.emit("placed", nodes=[astuple(node) for node in node_placement(session)])
        names = [output.name for output in session.get_outputs()]
        for inputs in self._frames("plain"):
            outputs = session.run(names, inputs)
            self._emit_frame("plain", dict(zip(names, outputs, strict=True)))

    def _run_with_graph_capture(self) -> None:
        """Capture the first frame, and compute the others by replay with the same buffers."""
        session = self.opener(Path(self.job["model"]), capture=True)
        self.emit("accepted")
        bound: BoundSession | None = None
        for inputs in self._frames("captured"):
            if bound is None:
                shapes = {name: array.shape for name, array in inputs.items()}
                bound = BoundSession(session, shapes, inputs, BUFFER_MEMORY["webgpu"])
            bound.write(inputs)
            bound.run()
            self._emit_frame("captured", bound.copies())


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
