"""An ONNX Runtime session whose inputs and outputs stay bound to fixed buffers."""

__all__ = ["BoundSession", "TensorSpec", "host_bytes", "tensor_specs", "translate_error"]

import math
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gsgen.contract.errors import GsgenError
from gsgen.contract.model.load_failures import explain_load_failure
from gsgen.sdk.binding.providers.buffers import Buffer, HostMemory, make_buffer
from gsgen.sdk.binding.providers.cancellation import Stop
from gsgen.sdk.binding.providers.errors import RunFailed, SizeUnknown

# A run with this graph number is neither captured nor replayed.
_NO_CUDA_GRAPH_OPTION = ("gpu_graph_id", "-1")
# The largest buffer of drivers; larger requests hang instead of failing.
_BUFFER_BYTES = (4 << 30) - 1
# ONNX Runtime's message if an output does not fit its bound buffer.
_SIZE_MISMATCH = re.compile(
    r"output '([^']*)' of node .* has shape \{([\d,]*)\} but the computed output shape for this "
    r"run is \{([\d,]*)\}"
)
_DTYPE_BY_ONNX_NAME = {
    "tensor(bool)": "bool", "tensor(double)": "float64", "tensor(float)": "float32",
    "tensor(float16)": "float16", "tensor(int16)": "int16", "tensor(int32)": "int32",
    "tensor(int64)": "int64", "tensor(int8)": "int8", "tensor(uint16)": "uint16",
    "tensor(uint32)": "uint32", "tensor(uint64)": "uint64", "tensor(uint8)": "uint8",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class TensorSpec:
    """Name, dtype and dimensions of an input or output of an ONNX Runtime session."""

    name: str  # the tensor's name
    dtype: np.dtype[Any]  # the tensor's dtype
    dims: tuple[int | str | None, ...]  # sizes; a symbol or None for an open dimension

    def shape(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """Return the static shape of the tensor; ``sizes`` resolves symbolic dimensions.

        Raises :class:`SizeUnknown` for a dimension without a size.
        """
        return tuple(self._size(axis, sizes) for axis in range(len(self.dims)))

    @property
    def static(self) -> bool:
        """Whether every dimension of the tensor has a fixed size."""
        return all(isinstance(dim, int) for dim in self.dims)

    def _size(self, axis: int, sizes: Mapping[str, int]) -> int:
        dim = self.dims[axis]
        if isinstance(dim, int):
            return dim
        key = dim or f"{self.name}[{axis}]"
        if key in sizes:
            return sizes[key]
        message = f"axis {axis} is symbolic ({dim or 'nameless'}), expected a size"
        hint = f"Give its size: `--size {key}=24`, or in Python sizes={{{key!r}: 24}}."
        raise SizeUnknown(message, where=f"tensor {self.name}", hint=hint)


def tensor_specs(arguments: Any) -> tuple[TensorSpec, ...]:
    """Return name, dtype and dimensions of each input or output of an ONNX Runtime session."""
    tensors = []
    for argument in arguments:
        if argument.type not in _DTYPE_BY_ONNX_NAME:
            message = f"is a {argument.type}, expected a numeric tensor"
            raise RunFailed(message, where=f"tensor {argument.name}")
        tensors.append(
            TensorSpec(
                argument.name, np.dtype(_DTYPE_BY_ONNX_NAME[argument.type]), tuple(argument.shape)
            )
        )
    return tuple(tensors)


class BoundSession:
    """An ONNX Runtime session with bound input and output buffers, for one thread at a time.

    Attributes:
        session: ONNX Runtime's session.
        inputs: Name → buffer.
        outputs: Name → buffer.
    """

    def __init__(
        self,
        session: Any,
        shapes: Mapping[str, tuple[int, ...]],
        start: Mapping[str, np.ndarray],
        memory: str,
        stop: Stop | None = None,
        host_memory: HostMemory | None = None,
    ) -> None:
        """Create and bind buffers for all inputs and outputs of an ONNX Runtime session.

        ``shapes`` and ``start`` are by input name; ``memory`` is ``cpu``, ``gpu`` or ``cuda``.
        ``host_memory`` allocates their arrays on the host.
        """
        stop = stop or Stop()
        self.session = session
        self._memory, self._host_memory = memory, host_memory or HostMemory()
        self._read: dict[str, np.ndarray] = {}
        self._binding = session.io_binding()
        self._options, self._uncaptured_options = stop.options(), stop.options()
        self._uncaptured_options.add_run_config_entry(*_NO_CUDA_GRAPH_OPTION)
        self.inputs = {
            spec.name: self._bind_input(spec, shapes[spec.name])
            for spec in tensor_specs(session.get_inputs())
        }
        self.write(start)
        self.outputs = self._bind_outputs(tensor_specs(session.get_outputs()))

    def write(self, tensors: Mapping[str, np.ndarray]) -> frozenset[str]:
        """Copy tensors into a session's input buffers; return the names of changed model inputs."""
        return frozenset(
            [name for name, array in tensors.items() if self.inputs[name].write(array)]
        )

    def run(self) -> None:
        """Compute a frame; with graph capture, the first frame is recorded, later ones replayed."""
        self._read.clear()
        self.session.run_with_iobinding(self._binding, self._options)

    def run_uncaptured(self) -> None:
        """Compute a frame without graph capture: every GPU kernel is launched again."""
        self._read.clear()
        self.session.run_with_iobinding(self._binding, self._uncaptured_options)

    def read(self, name: str) -> np.ndarray:
        """Return a model output as a read-only array, copied from the device once per frame."""
        if name not in self._read:
            self._read[name] = self.outputs[name].read()
        return self._read[name]

    def copies(self) -> dict[str, np.ndarray]:
        """Return copies of all model outputs, by output name."""
        return {name: self.read(name).copy() for name in self.outputs}

    def close(self) -> None:
        """Release the graph capture, then the buffers, then the ONNX Runtime session."""
        if self._memory == "gpu":
            self.session.release_captured_graph()
        self._binding.clear_binding_inputs()
        self._binding.clear_binding_outputs()
        self.inputs, self.outputs, self._read = {}, {}, {}
        del self._binding, self.session

    def _bind_input(self, spec: TensorSpec, shape: tuple[int, ...]) -> Buffer:
        buffer = self._make_buffer(shape, spec.dtype)
        self._binding.bind_ortvalue_input(spec.name, buffer.value)
        return buffer

    def _make_buffer(self, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Buffer:
        return make_buffer(self.session, shape, dtype, self._memory, self._host_memory)

    def _bind_outputs(self, output_specs: tuple[TensorSpec, ...]) -> dict[str, Buffer]:
        shapes = {spec.name: spec.shape({}) for spec in output_specs if spec.static}
        if len(shapes) < len(output_specs):
            shapes = self._learn_shapes(output_specs)
        _check_output_sizes(output_specs, shapes, self._memory)
        # An output that is also an input has no buffer of its own in ONNX Runtime: share the input's.
        buffers = {
            spec.name: self.inputs.get(spec.name)
            or self._make_buffer(shapes[spec.name], spec.dtype)
            for spec in output_specs
        }
        for name, buffer in buffers.items():
            self._binding.bind_ortvalue_output(name, buffer.value)
        return buffers

    def _learn_shapes(self, output_specs: tuple[TensorSpec, ...]) -> dict[str, tuple[int, ...]]:
        """Run the model once without output buffers, and return the shapes of its outputs."""
        for spec in output_specs:
            self._binding.bind_output(spec.name, "cpu")
        try:
            self.run_uncaptured()
        except Exception as error:  # ONNX Runtime's errors share no base class of their own
            raise translate_error(error) from error
        values = self._binding.get_outputs()
        shapes = {
            spec.name: tuple(value.shape())
            for spec, value in zip(output_specs, values, strict=True)
        }
        self._binding.clear_binding_outputs()
        return shapes


def _check_output_sizes(
    output_specs: tuple[TensorSpec, ...], shapes: Mapping[str, tuple[int, ...]], memory: str
) -> None:
    """Raise if the model's outputs are too large to be allocated safely."""
    limit, limit_name = host_bytes(), "this machine's memory"
    if memory == "gpu" and limit > _BUFFER_BYTES:
        limit, limit_name = _BUFFER_BYTES, "the largest buffer of WebGPU"
    for spec in output_specs:
        size = math.prod(shapes[spec.name]) * spec.dtype.itemsize
        if size > limit:
            raise RunFailed(
                f"the output of shape {list(shapes[spec.name])} takes {size / 1e9:.1f} GB, "
                f"more than {limit_name}",
                where=f"output {spec.name}",
            )


def host_bytes() -> int:
    """Return the bytes of memory of this machine."""
    if hasattr(os, "sysconf"):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return sys.maxsize  # Windows has no sysconf


def translate_error(error: Exception) -> GsgenError:
    """Convert an error of ONNX Runtime to a GsgenError with a readable message."""
    if isinstance(error, GsgenError):
        return error
    mismatch = _SIZE_MISMATCH.search(str(error))
    if mismatch is not None:
        return _shape_changed_error(*mismatch.groups())
    failure = explain_load_failure(str(error))
    hint = failure.hint or "`gsgen validate --level live` reports the rule that the model violates."
    return RunFailed(failure.cause, where="ONNX Runtime", hint=hint)


def _shape_changed_error(output: str, bound: str, computed: str) -> RunFailed:
    return RunFailed(
        f"has shape [{computed}], but had [{bound}] when the session was opened: its size depends "
        "on input values, and buffers have a fixed size",
        where=f"output {output}",
        hint="Export it with a capacity: a fixed number of rows, num_points of which are live. "
        "`gsgen explain GO004` gives the reason.",
    )
