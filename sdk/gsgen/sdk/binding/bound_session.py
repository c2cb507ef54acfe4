"""One ONNX Runtime session whose inputs and outputs are bound once, for good."""

__all__ = ["Bound", "Spec", "failed", "specs"]

import math
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gsgen.contract.errors import GsgenError
from gsgen.sdk.binding.buffers import Buffer, make_buffer
from gsgen.sdk.binding.providers.cancellation import Stop
from gsgen.sdk.binding.providers.errors import RunFailed, SizeUnknown
from gsgen.sdk.binding.providers.node_placement import words

# A run with this graph number is neither captured nor replayed.
_NO_GRAPH = ("gpu_graph_id", "-1")
# Drivers have no larger ones, and hang rather than say so.
_BUFFER_BYTES = (4 << 30) - 1
# ONNX Runtime's words where an output does not fit the buffer that it is bound to.
_OTHER_SIZE = re.compile(
    r"output '([^']*)' of node .* has shape \{([\d,]*)\} but the computed output shape for this "
    r"run is \{([\d,]*)\}"
)
_DTYPES = {
    "tensor(bool)": "bool",
    "tensor(double)": "float64",
    "tensor(float)": "float32",
    "tensor(float16)": "float16",
    "tensor(int16)": "int16",
    "tensor(int32)": "int32",
    "tensor(int64)": "int64",
    "tensor(int8)": "int8",
    "tensor(uint16)": "uint16",
    "tensor(uint32)": "uint32",
    "tensor(uint64)": "uint64",
    "tensor(uint8)": "uint8",
}


@dataclass(frozen=True, slots=True)
class Spec:
    """A tensor of a session.

    Attributes:
        name: Its name.
        dtype: Its dtype.
        dims: Its sizes; a symbol or None where nothing says.
    """

    name: str
    dtype: np.dtype[Any]
    dims: tuple[int | str | None, ...]

    def shape(self, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """Return the static shape; ``sizes`` may name a nameless dimension ``NAME[AXIS]``.

        Raises:
            SizeUnknown: A dimension has no size.
        """
        return tuple(self._size(axis, sizes) for axis in range(len(self.dims)))

    @property
    def static(self) -> bool:
        """Whether every dimension is a number."""
        return all(isinstance(dim, int) for dim in self.dims)

    def _size(self, axis: int, sizes: Mapping[str, int]) -> int:
        dim = self.dims[axis]
        if isinstance(dim, int):
            return dim
        key = dim or f"{self.name}[{axis}]"
        if key in sizes:
            return sizes[key]
        what = f"axis {axis} is symbolic ({dim or 'nameless'}), wanted a size"
        hint = f"Give one: `--size {key}=24`, or in Python sizes={{{key!r}: 24}}."
        raise SizeUnknown(what, where=f"tensor {self.name}", hint=hint)


def specs(arguments: Any) -> tuple[Spec, ...]:
    """Return what ONNX Runtime says of a session's inputs or outputs.

    Raises:
        RunFailed: One is no numeric tensor.
    """
    made = []
    for one in arguments:
        if one.type not in _DTYPES:
            what = f"is a {one.type}, wanted a numeric tensor"
            raise RunFailed(what, where=f"tensor {one.name}")
        made.append(Spec(one.name, np.dtype(_DTYPES[one.type]), tuple(one.shape)))
    return tuple(made)


class Bound:
    """A session and its buffers; whoever holds it calls it from one thread at a time.

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
    ) -> None:
        """Bind everything.

        Args:
            session: ONNX Runtime's session.
            shapes: Input name → shape.
            start: Input name → the tensor that it holds at first.
            memory: Where buffers are: ``cpu``, ``gpu`` or ``cuda``.
            stop: Ends its runs.

        Raises:
            RunFailed: An output is too large to hold, or the session cannot be run even to learn
                its outputs' shapes.
        """
        stop = stop or Stop()
        self.session = session
        self._memory = memory
        self._read: dict[str, np.ndarray] = {}
        self._binding = session.io_binding()
        self._options, self._plainly = stop.options(), stop.options()
        self._plainly.add_run_config_entry(*_NO_GRAPH)
        self.inputs = {
            one.name: self._bind_input(one, shapes[one.name])
            for one in specs(session.get_inputs())
        }
        self.write(start)
        self.outputs = self._bind_outputs(specs(session.get_outputs()))

    def write(self, tensors: Mapping[str, np.ndarray]) -> frozenset[str]:
        """Put tensors into the inputs' buffers; return which held something else before."""
        return frozenset(
            [name for name, array in tensors.items() if self.inputs[name].write(array)]
        )

    def run(self) -> None:
        """Compute a frame; a session that captures records the first and replays the others."""
        self._read.clear()
        self.session.run_with_iobinding(self._binding, self._options)

    def run_plainly(self) -> None:
        """Compute a frame by launching every kernel anew, whatever the session does else."""
        self._read.clear()
        self.session.run_with_iobinding(self._binding, self._plainly)

    def read(self, name: str) -> np.ndarray:
        """Return an output, read-only; a frame's is copied from the device once."""
        if name not in self._read:
            self._read[name] = self.outputs[name].read()
        return self._read[name]

    def copies(self) -> dict[str, np.ndarray]:
        """Return all outputs as arrays of their own."""
        return {name: self.read(name).copy() for name in self.outputs}

    def close(self) -> None:
        """Release the capture, the buffers and the session, in this order."""
        if self._memory == "gpu":
            self.session.release_captured_graph()
        self._binding.clear_binding_inputs()
        self._binding.clear_binding_outputs()
        self.inputs, self.outputs, self._read = {}, {}, {}
        del self._binding, self.session

    def _bind_input(self, spec: Spec, shape: tuple[int, ...]) -> Buffer:
        buffer = make_buffer(self.session, shape, spec.dtype, self._memory)
        self._binding.bind_ortvalue_input(spec.name, buffer.value)
        return buffer

    def _bind_outputs(self, wanted: tuple[Spec, ...]) -> dict[str, Buffer]:
        known = {one.name: one.shape({}) for one in wanted if one.static}
        if len(known) < len(wanted):
            known = self._learn_shapes(wanted)
        _refuse_giants(wanted, known, self._memory)
        # ONNX Runtime fills no buffer for an output that is an input itself: there, it is the same.
        made = {
            one.name: self.inputs.get(one.name)
            or make_buffer(self.session, known[one.name], one.dtype, self._memory)
            for one in wanted
        }
        for name, buffer in made.items():
            self._binding.bind_ortvalue_output(name, buffer.value)
        return made

    def _learn_shapes(self, wanted: tuple[Spec, ...]) -> dict[str, tuple[int, ...]]:
        """Run once without buffers for outputs, to see how large they are."""
        for one in wanted:
            self._binding.bind_output(one.name, "cpu")
        try:
            self.run_plainly()
        except Exception as error:  # ONNX Runtime's errors share no base class of their own
            raise failed(error) from error
        made = self._binding.get_outputs()
        shapes = {
            one.name: tuple(value.shape()) for one, value in zip(wanted, made, strict=True)
        }
        self._binding.clear_binding_outputs()
        return shapes


def _refuse_giants(
    wanted: tuple[Spec, ...], shapes: Mapping[str, tuple[int, ...]], memory: str
) -> None:
    """Raise where outputs cannot be held; allocating them might hang a driver or a machine."""
    limit, whose = _host_bytes(), "this machine's memory"
    if memory == "gpu" and limit > _BUFFER_BYTES:
        limit, whose = _BUFFER_BYTES, "the largest buffer of WebGPU"
    for one in wanted:
        size = math.prod(shapes[one.name]) * one.dtype.itemsize
        if size > limit:
            what = f"shape {list(shapes[one.name])} takes {size / 1e9:.1f} GB"
            raise RunFailed(f"{what}, more than {whose}", where=f"output {one.name}")


def _host_bytes() -> int:
    if hasattr(os, "sysconf"):
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return sys.maxsize  # no such question on Windows


def failed(error: Exception) -> GsgenError:
    """Return an error of ONNX Runtime as one that a user can read."""
    if isinstance(error, GsgenError):
        return error
    other = _OTHER_SIZE.search(str(error))
    if other is not None:
        return _resized(*other.groups())
    hint = "`gsgen validate --level live` says which rule the model breaks."
    return RunFailed(words(error), where="ONNX Runtime", hint=hint)


def _resized(output: str, bound: str, computed: str) -> RunFailed:
    return RunFailed(
        f"has shape [{computed}], and had [{bound}] when the session was opened: its size depends "
        "on the values of inputs, but frames stay in buffers of one size",
        where=f"output {output}",
        hint="Export it with a capacity: rows of one number, of which num_points says how many "
        "are live. `gsgen explain GO004` says why.",
    )
