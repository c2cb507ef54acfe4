"""Exports of equal generators share the traced graph.

Torch takes most of an export's time for it. A test run exports some generators ten times: in float32
and in float16, which are rewritten from the same float32 graph, and with other options of ours.
"""

__all__ = ["share_traces"]

import hashlib
import io
import pickle
from collections import OrderedDict
from collections.abc import Sequence
from types import FunctionType
from typing import Any

import onnx_ir as ir
import pytest
import torch

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.authoring.output_names import output_names
from gsgen.sdk.authoring.packed_module import PackedGenerator
from gsgen.sdk.exporting import exporter
from gsgen.sdk.exporting.tracing.trace import trace_generator

_MOST = 24
# The graph of each content, and the classes and functions that stand for themselves in it.
_traces: OrderedDict[Any, tuple[ir.Model, list[object]]] = OrderedDict()


def share_traces(patch: pytest.MonkeyPatch) -> None:
    """Let exports of generators of equal content, at equal inputs and sizes, trace one of them."""
    patch.setattr(exporter, "trace_generator", _shared_trace)


def _shared_trace(
    packed: PackedGenerator,
    example: Probe,
    manifest: GeneratorManifest,
    opset: int,
    hazards: Sequence[Any] = (),
) -> ir.Model:
    """Return a copy of the traced graph of a generator of equal content, which is traced once."""
    content = io.BytesIO()
    reader = _ContentPickler(content, protocol=5)
    reader.dump(packed)
    values = tuple(
        (name, value.dtype.str, value.shape, value.tobytes())
        for name, value in example.inputs.items()
    )
    color = manifest.outputs.appearance
    # A padded degree of harmonics makes another graph, and so does another storage.
    degree = color and color.degree
    digest = hashlib.sha256(content.getvalue()).digest()
    key = (digest, tuple(output_names(manifest)), degree, opset, values)
    if key not in _traces:
        _traces[key] = trace_generator(packed, example, manifest, opset, hazards), reader.kept
        if len(_traces) > _MOST:
            _traces.popitem(last=False)
    _traces.move_to_end(key)
    return _traces[key][0].clone()


class _ContentPickler(pickle.Pickler):
    """Writes all that a module holds: numbers by value, classes and functions by their identity.

    Nothing reads it again: equal modules are known by equal bytes.

    Attributes:
        kept: The classes and functions, so that no other one gets an identity.
    """

    def __init__(self, file: io.BytesIO, protocol: int) -> None:
        super().__init__(file, protocol)
        self.kept: list[object] = []

    def reducer_override(self, value: Any) -> Any:
        """Reduce tensors to their numbers; torch's own reduction packs each into an archive."""
        if isinstance(value, torch.Tensor):
            numbers = value.detach().contiguous().reshape(-1).view(torch.uint8).numpy().tobytes()
            layout = (value.dtype, tuple(value.shape), value.stride(), value.requires_grad)
            return str, (hashlib.sha256(numbers).hexdigest() + repr(layout),)
        if isinstance(value, (type, FunctionType)) and value is not str:
            self.kept.append(value)
            return str, (str(id(value)),)
        return NotImplemented
