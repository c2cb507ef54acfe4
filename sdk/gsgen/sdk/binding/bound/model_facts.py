"""Facts about a model before it runs: graph structure, manifest, symbolic dimensions."""

__all__ = ["ModelFacts", "Tensors", "read_model_facts"]

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.model.graph import Graph, read_graph
from gsgen.contract.model.model_file import ModelFile, open_model
from gsgen.contract.probing.probes import default_probes
from gsgen.contract.spec.manifest import GeneratorManifest, Input, Manifest
from gsgen.contract.spec.manifest_io import loads
from gsgen.contract.spec.onnx_facts import CONTROL_FLOW, MAIN_DOMAIN, RANDOM_OPERATORS
from gsgen.sdk.binding.bound.bound_session import TensorSpec
from gsgen.sdk.binding.bound.input_binding import InputBinding
from gsgen.sdk.binding.bound.replay_check import output_origin

# Two of this many probes are used; they differ even if time loops.
_PROBE_COUNT, _PROBE_INDICES = 4, (1, 3)

Tensors = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class ModelFacts:
    """A model's file and manifest, with facts derived from both."""

    path: Path  # the ONNX file
    file: ModelFile  # the file's structure
    manifest: Manifest | None  # the meaning of its tensors; None without a manifest

    @cached_property
    def graph(self) -> Graph:
        """The model's graph, which is read on first use to explain errors."""
        return read_graph(self.file)

    @cached_property
    def constant_outputs(self) -> frozenset[str]:
        """Names of the outputs that are computed from weights alone: each frame has the same.

        Operators that are not ONNX's own, and those with subgraphs, may draw random numbers.
        """
        graph = self.file.proto.graph
        function_keys = {(function.domain, function.name) for function in self.file.proto.functions}
        constant = {tensor.name for tensor in graph.initializer}
        constant |= {tensor.values.name for tensor in graph.sparse_initializer}
        for node in graph.node:
            repeated_outputs = (
                node.domain in MAIN_DOMAIN
                and node.op_type not in RANDOM_OPERATORS
                and (node.domain, node.op_type) not in function_keys
                and node.op_type not in CONTROL_FLOW
            )
            if repeated_outputs and constant.issuperset(filter(None, node.input)):
                constant.update(filter(None, node.output))
        return frozenset(value.name for value in graph.output if value.name in constant)

    def output_origin(self, output: str) -> str:
        """Return name and operator of the graph node that computes an output, as text."""
        return output_origin(self.graph, output)

    def input_binding(self, spec: TensorSpec, sizes: Mapping[str, int]) -> InputBinding:
        """Return a model input together with its declaration in the manifest."""
        space = self.manifest.space if isinstance(self.manifest, GeneratorManifest) else None
        order = space.matrix_order if space else "column"
        shape = spec.shape(sizes)
        return InputBinding(
            name=spec.name,
            dtype=spec.dtype,
            shape=shape,
            declared=self._declared.get(spec.name),
            order=order,
        )

    def sizes(self, sizes: Mapping[str, int]) -> dict[str, int]:
        """Return the sizes of symbolic dimensions: from ``sizes``, else from the manifest."""
        size_by_symbol = dict(self.open_dimensions())
        for name, size in sizes.items():
            if not size_by_symbol:
                message = f"the model has no open dimension, so {name!r} needs no size"
                raise ConfigInvalid(message, where=str(self.path))
            if name not in size_by_symbol:
                raise UnknownName.among("open dimension", name, size_by_symbol, str(self.path))
            if not size > 0:
                raise ConfigInvalid(
                    f"the size is {size}, expected at least 1", where=f"size {name}"
                )
        declared = {name: size for name, size in size_by_symbol.items() if size is not None}
        return declared | dict(sizes)

    def probes(self, ports: Iterable[InputBinding]) -> list[Tensors]:
        """Return two different sets of test inputs: from the manifest, or else random numbers."""
        entries = list(ports)
        if self.manifest is not None and set(self._declared) == {p.name for p in entries}:
            shapes = {port.name: port.shape for port in entries}
            dtypes = {port.name: port.dtype.name for port in entries}
            probes = default_probes(self.manifest, shapes, dtypes, count=_PROBE_COUNT)
            return [probes[min(k, len(probes) - 1)].inputs for k in _PROBE_INDICES]
        rng = np.random.default_rng(0)
        return [
            {port.name: _random_input(port, rng, max_value) for port in entries}
            for max_value in (1, 2)
        ]

    @property
    def _declared(self) -> dict[str, Input]:
        return {i.name: i for i in self.manifest.inputs} if self.manifest else {}

    def open_dimensions(self) -> Iterator[tuple[str, int | None]]:
        """Yield the symbolic dimensions of all model inputs, with sizes that the manifest declares.

        A dimension without a symbol is called ``NAME[AXIS]``.
        """
        weights = {tensor.name for tensor in self.file.proto.graph.initializer}
        for value in self.file.proto.graph.input:
            entry = self._declared.get(value.name)
            shape = (entry.shape if entry else None) or ()
            for axis, dim in enumerate(value.type.tensor_type.shape.dim):
                if not dim.HasField("dim_value") and value.name not in weights:
                    size = shape[axis] if axis < len(shape) else None
                    yield dim.dim_param or f"{value.name}[{axis}]", size


def _random_input(port: InputBinding, rng: np.random.Generator, max_value: int) -> np.ndarray:
    return np.asarray(rng.uniform(0, max_value, port.shape).round(3)).astype(port.dtype)


def read_model_facts(path: Path, manifest: Manifest | None) -> ModelFacts:
    """Read the structure of a model file, and its embedded manifest unless one is passed."""
    file = open_model(path)
    if manifest is None and file.manifest_text is not None:
        manifest = loads(file.manifest_text)
    return ModelFacts(path, file, manifest)
