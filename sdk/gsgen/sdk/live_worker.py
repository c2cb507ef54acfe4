"""The child of :mod:`gsgen.sdk.live`: run one model in ONNX Runtime's WebGPU provider, then exit.

Every frame is computed twice: by a plain session, then by one that captures its commands with the
first frame and replays them for the others. Both write down what they gave, so that the parent
can compare; whatever stops this process leaves all that was done before.
"""

__all__ = ["main"]

import os
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gsgen.contract.worker import (
    Emit,
    keep_outputs,
    limit_memory,
    read_inputs,
    serve,
)

# What drivers and shader compilers may take beside the model.
_DRIVER_BYTES = 2 << 30
# The loader tells, on demand, which device was opened.
_OPENED = re.compile(r'Using "([^"]+)" with driver')
_SOFTWARE = re.compile("llvmpipe|swiftshader|basic render|warp", re.IGNORECASE)
_CODES = re.compile(
    r"\[ONNXRuntimeError\] : \d+ : \w+ : |\S+\.(?:cc|h):\d+ .*? was false\. "
)
_LONGEST = 500
# Capture computes in 64-bit integers what the plain session leaves to the CPU, unless told.
_PLAIN = {"enableInt64": "1"}
_CAPTURING = {"enableGraphCapture": "1"}

Session = Any
Opener = Callable[..., Session]


class _Unavailable(Exception):
    """The provider or an adapter is missing here, which is no fault of the model."""


class _FellBack(Exception):
    """ONNX Runtime opened a session without the provider that it was told to use."""


def main(folder: Path) -> int:
    """Do the job described in ``folder/job.json``."""
    return serve(folder, _work)


def _work(folder: Path, job: dict[str, Any], emit: Emit) -> int:
    _set_surroundings(folder)
    try:
        import onnxruntime

        emit("started", version=onnxruntime.__version__)
        opener = _find_provider(folder, emit)
        _try_adapter(opener, folder, emit, half=job["half"])
        limit_memory(job["memory"] + _DRIVER_BYTES)
        if job["probes"]:
            _Frames(folder, job, emit, opener).run()
    except _Unavailable as error:
        emit("unavailable", what=str(error.args[0]), mend=str(error.args[1]))
    except _FellBack as error:
        emit("fell-back", message=str(error))
    emit("done")
    return 0


def _set_surroundings(folder: Path) -> None:
    """Say what drivers need to hear; what the user set already wins."""
    usual = {
        "ORT_WEBGPU_EP_ALLOW_SOFTWARE_ADAPTER": "1",
        "VK_LOADER_DEBUG": "driver",
        "XDG_RUNTIME_DIR": str(folder),
    }
    for name, value in usual.items():
        os.environ.setdefault(name, value)


def _find_provider(folder: Path, emit: Emit) -> Opener:
    """Register the WebGPU provider, and return what opens sessions with it."""
    import onnxruntime

    try:
        import onnxruntime_ep_webgpu as provider
    except ImportError as error:
        what = "onnxruntime-ep-webgpu is not installed"
        raise _Unavailable(what, "pip install 'gsgen[live]'") from error
    onnxruntime.set_default_logger_severity(3)
    # A name that ends in ".virtual" would abort the interpreter.
    onnxruntime.register_execution_provider_library("webgpu", provider.get_library_path())
    name = provider.get_ep_name()
    devices = [one for one in onnxruntime.get_ep_devices() if one.ep_name == name]
    if not devices:
        what = "ONNX Runtime lists no device for WebGPU"
        raise _Unavailable(what, "install a Vulkan driver, such as mesa-vulkan-drivers 25")
    hardware = onnxruntime.OrtHardwareDeviceType.GPU
    device = min(devices, key=lambda one: one.device.type != hardware)
    described = device.device.metadata.get("Description", device.device.vendor)
    emit("device", name=described, version=device.ep_metadata.get("version", ""))

    def open_session(model: str | bytes, options: dict[str, str]) -> Session:
        settings = onnxruntime.SessionOptions()
        settings.log_severity_level = 3
        settings.add_session_config_entry("session.record_ep_graph_assignment_info", "1")
        settings.add_provider_for_devices([device], options)
        # Without this, a missing adapter silently gives a session on the CPU.
        session = onnxruntime.InferenceSession(model, settings, enable_fallback=0)
        if name not in session.get_providers():
            raise _FellBack(f"wanted {name}, got {', '.join(session.get_providers())}")
        return session

    return open_session


def _try_adapter(opener: Opener, folder: Path, emit: Emit, *, half: bool) -> None:
    """Run the smallest model, in float16 too if the model needs that; say on which adapter."""
    try:
        _run_smallest(opener, "float32")
    except _FellBack:
        raise
    except Exception as error:  # ONNX Runtime's errors share no base class of their own
        what = f"there is no usable WebGPU adapter ({_words(error)})"
        raise _Unavailable(
            what, "install a Vulkan driver, such as mesa-vulkan-drivers 25"
        ) from error
    log = (folder / "log").read_text(errors="replace")
    opened = _OPENED.findall(log)
    name = opened[-1] if opened else ""
    try:
        _run_smallest(opener, "float16")
    except Exception as error:
        emit("adapter", name=name, software=bool(_SOFTWARE.search(name)), half=False)
        if half:
            what = f"the model has float16 tensors, and adapter {name or '?'} no shader-f16"
            raise _Unavailable(what, "use a newer driver") from error
    else:
        emit("adapter", name=name, software=bool(_SOFTWARE.search(name)), half=True)


def _run_smallest(opener: Opener, dtype: str) -> None:
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
    session = opener(model.SerializeToString(), {})
    (made,) = session.run(None, {"x": np.arange(4, dtype=dtype)})
    if made.tolist() != [0, 2, 4, 6]:
        raise RuntimeError(f"0..3 doubled are {made.tolist()}")


class _Frames:
    """The frames of one model, computed plainly and by replay."""

    def __init__(
        self, folder: Path, job: dict[str, Any], emit: Emit, opener: Opener
    ) -> None:
        self.folder, self.job, self.emit, self.opener = folder, job, emit, opener
        self.known: dict[str, int] = {}

    def run(self) -> None:
        first = self._phase("plain", self._plain)
        if first is not None:
            self._phase("captured", lambda: self._captured(first))

    def _phase(self, name: str, work: Callable[[], Any]) -> Any:
        """Do ``work``; what stops it is written down as a fact about the model."""
        self.at = -1
        try:
            return work()
        except _FellBack:
            raise
        except Exception as error:
            self.emit("stopped", phase=name, frame=self.at, message=_words(error))
            return None

    def _frames(self, phase: str) -> Iterator[dict[str, np.ndarray]]:
        for at, names in enumerate(self.job["probes"]):
            self.at = at
            self.emit("begin", phase=phase, probe=at)
            yield read_inputs(self.folder / f"probe_{self.at}.npz", names)

    def _keep(self, phase: str, outputs: dict[str, np.ndarray]) -> None:
        sample = keep_outputs(self.folder, outputs, self.known, self.emit)
        self.emit("frame", phase=phase, frame=self.at, sample=sample)

    def _plain(self) -> dict[str, np.ndarray]:
        """Run every frame; return the outputs of the first."""
        session = self.opener(self.job["model"], _PLAIN)
        self.emit("placed", nodes=_placement(session))
        names = [one.name for one in session.get_outputs()]
        first: dict[str, np.ndarray] = {}
        for inputs in self._frames("plain"):
            outputs = dict(zip(names, session.run(names, inputs), strict=True))
            self._keep("plain", outputs)
            first = first or outputs
        return first

    def _captured(self, like: dict[str, np.ndarray]) -> None:
        """Capture the first frame and replay it for the others; all buffers stay in place."""
        session = self.opener(self.job["model"], _CAPTURING)
        self.emit("accepted")
        binding = session.io_binding()
        outputs = {name: _buffer(session, array) for name, array in like.items()}
        for name, buffer in outputs.items():
            binding.bind_ortvalue_output(name, buffer)
        bound: dict[str, Any] = {}
        for inputs in self._frames("captured"):
            for name, array in inputs.items():
                if name not in bound:
                    bound[name] = _buffer(session, array)
                    binding.bind_ortvalue_input(name, bound[name])
                bound[name].update_inplace(np.ascontiguousarray(array))
            session.run_with_iobinding(binding)
            self._keep("captured", {name: one.numpy() for name, one in outputs.items()})


def _words(error: Exception) -> str:
    """Return what ONNX Runtime says, without its codes, source files and conditions."""
    return _CODES.sub("", " ".join(str(error).split()))[:_LONGEST] or type(error).__name__


def _buffer(session: Session, like: np.ndarray) -> Any:
    return session.create_ortvalue_from_shape_and_type(
        list(like.shape), like.dtype.type, "gpu", 0
    )


def _placement(session: Session) -> list[tuple[str, str, str]]:
    """Return (provider, operator, name) of every node."""
    return [
        (part.ep_name, node.op_type, node.name)
        for part in session.get_provider_graph_assignment_info()
        for node in part.get_nodes()
    ]


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
