"""What is known of a model before it runs: its structure, its manifest, and what to try it with."""

__all__ = ["Sources", "Tensors", "read_sources"]

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
from gsgen.sdk.binding.bound_session import Spec
from gsgen.sdk.binding.input_binding import InputBinding
from gsgen.sdk.binding.replay_check import maker

# Of this many probes, two are used that differ even where time loops.
_PROBES, _CHOSEN = 4, (1, 3)

Tensors = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Sources:
    """A model's file, and what its tensors mean.

    Attributes:
        path: The ONNX file.
        file: Its structure.
        manifest: What its tensors mean; None where nobody says.
    """

    path: Path
    file: ModelFile
    manifest: Manifest | None

    @cached_property
    def graph(self) -> Graph:
        """The graph, read when something has to be explained."""
        return read_graph(self.file)

    def blame(self, output: str) -> str:
        """Say where an output comes from."""
        return maker(self.graph, output)

    def port(self, spec: Spec, sizes: Mapping[str, int]) -> InputBinding:
        """Return an input with what the manifest says of it.

        Raises:
            SizeUnknown: A dimension has no size.
        """
        space = (
            self.manifest.space if isinstance(self.manifest, GeneratorManifest) else None
        )
        order = space.matrix_order if space else "column"
        shape = spec.shape(sizes)
        return InputBinding(
            spec.name, spec.dtype, shape, self._declared.get(spec.name), order
        )

    def sizes(self, given: Mapping[str, int]) -> dict[str, int]:
        """Return the size of each open dimension that is known: as given, else as declared.

        Raises:
            UnknownName: A size is given for what is no open dimension.
            ConfigInvalid: A size is not positive.
        """
        opened = dict(self.open_dimensions())
        for name, size in given.items():
            if not opened:
                what = f"the model has no open dimension, so {name!r} needs no size"
                raise ConfigInvalid(what, where=str(self.path))
            if name not in opened:
                raise UnknownName.among("open dimension", name, opened, str(self.path))
            if not size > 0:
                raise ConfigInvalid(f"is {size}, wanted at least 1", where=f"size {name}")
        declared = {name: size for name, size in opened.items() if size is not None}
        return declared | dict(given)

    def probes(self, ports: Iterable[InputBinding]) -> list[Tensors]:
        """Return two sets of inputs that differ: the manifest's probes, else random numbers."""
        entries = list(ports)
        if self.manifest is not None and set(self._declared) == {p.name for p in entries}:
            shapes = {port.name: port.shape for port in entries}
            dtypes = {port.name: port.dtype.name for port in entries}
            made = default_probes(self.manifest, shapes, dtypes, count=_PROBES)
            return [made[min(k, len(made) - 1)].inputs for k in _CHOSEN]
        rng = np.random.default_rng(0)
        return [{port.name: _random(port, rng, top) for port in entries} for top in (1, 2)]

    @property
    def _declared(self) -> dict[str, Input]:
        return {i.name: i for i in self.manifest.inputs} if self.manifest else {}

    def open_dimensions(self) -> Iterator[tuple[str, int | None]]:
        """Yield each dimension of an input that the graph leaves open, with its declared size.

        One that has no symbol is called ``NAME[AXIS]``.
        """
        weights = {tensor.name for tensor in self.file.proto.graph.initializer}
        for value in self.file.proto.graph.input:
            entry = self._declared.get(value.name)
            shape = (entry.shape if entry else None) or ()
            for axis, dim in enumerate(value.type.tensor_type.shape.dim):
                if not dim.HasField("dim_value") and value.name not in weights:
                    size = shape[axis] if axis < len(shape) else None
                    yield dim.dim_param or f"{value.name}[{axis}]", size


def _random(port: InputBinding, rng: np.random.Generator, top: int) -> np.ndarray:
    return np.asarray(rng.uniform(0, top, port.shape).round(3)).astype(port.dtype)


def read_sources(path: Path, manifest: Manifest | None) -> Sources:
    """Open a model's structure, and read its manifest unless one is given.

    Raises:
        ModelUnreadable: The file is no ONNX model.
        ManifestInvalid: The embedded manifest cannot be read.
    """
    file = open_model(path)
    if manifest is None and file.manifest_text is not None:
        manifest = loads(file.manifest_text)
    return Sources(path, file, manifest)
