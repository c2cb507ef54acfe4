"""What static rules look at: a model's graph beside the manifest that explains it."""

__all__ = ["InspectedModel", "inspect_model"]

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from gsgen.contract.model.graph import Graph, Tensor, read_graph
from gsgen.contract.model.manifest_inference import Candidate, infer_manifest
from gsgen.contract.model.model_file import ModelFile
from gsgen.contract.model.provider_placement import Placement, placements
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.manifest import (
    AppearanceOutput,
    CellsOutput,
    CountOutput,
    GaussiansOutput,
    GeneratorManifest,
    Input,
    Manifest,
)
from gsgen.contract.spec.manifest_io import Parsed, parse
from gsgen.contract.spec.operator_tables import operator_table
from gsgen.contract.spec.targets import Target


@dataclass(frozen=True)
class InspectedModel:
    """One model under judgement.

    Attributes:
        file: The opened file.
        graph: Its graph.
        parsed: What became of the embedded manifest; None where there is none.
        candidate: What was guessed in its place; None where a manifest is embedded.
        target: The consumer it is judged for.
        limits: What running it may use, as its user set it.
        tolerances: Those that its user set, by field, over what the manifest says.
    """

    file: ModelFile
    graph: Graph
    parsed: Parsed | None
    candidate: Candidate | None
    target: Target
    limits: Limits
    tolerances: Mapping[str, float] = field(default_factory=dict)

    @property
    def manifest(self) -> Manifest | None:
        """The embedded manifest, else the guessed one, else None."""
        if self.parsed is not None:
            return self.parsed.manifest
        return self.candidate.manifest if self.candidate else None

    @cached_property
    def granted(self) -> Limits:
        """What running it may use in fact: the limits, and on top what its weights take."""
        return self.limits.for_model(self.file.weight_bytes)

    @property
    def declared_version(self) -> str:
        """The contract that the manifest says it keeps, before any upgrade; empty without one."""
        version = self.parsed.version if self.parsed else None
        return f"{version[0]}.{version[1]}" if version else ""

    @property
    def kind(self) -> str:
        """The kind of model; without a manifest, the one that was guessed."""
        manifest = self.manifest
        return manifest.kind if manifest else ""

    @property
    def generator(self) -> GeneratorManifest | None:
        """The manifest, where it is that of a Gaussian Generator."""
        return self.manifest if isinstance(self.manifest, GeneratorManifest) else None

    @cached_property
    def declared_gaussians(self) -> GaussiansOutput | None:
        """What the manifest says of the packed rows."""
        return self.generator.outputs.gaussians if self.generator else None

    @cached_property
    def declared_appearance(self) -> AppearanceOutput | None:
        """What the manifest says of the appearance."""
        return self.generator.outputs.appearance if self.generator else None

    @cached_property
    def declared_count(self) -> CountOutput | None:
        """What the manifest says of the row count."""
        return self.generator.outputs.count if self.generator else None

    @cached_property
    def declared_cells(self) -> CellsOutput | None:
        """What the manifest says of the cells that a weighted sum is sorted by."""
        return self.generator.outputs.cells if self.generator else None

    @property
    def gaussians(self) -> Tensor | None:
        """The graph output that holds the packed rows."""
        return self._output(self.declared_gaussians)

    @property
    def appearance(self) -> Tensor | None:
        """The graph output that holds the appearance."""
        return self._output(self.declared_appearance)

    @property
    def count(self) -> Tensor | None:
        """The graph output that holds the row count."""
        return self._output(self.declared_count)

    @property
    def cells(self) -> Tensor | None:
        """The graph output that holds the cells."""
        return self._output(self.declared_cells)

    @cached_property
    def output_names(self) -> tuple[str, ...]:
        """Names of all outputs that the manifest declares, in its order."""
        manifest = self.manifest
        parts = (
            (getattr(manifest.outputs, name) for name in _output_fields(manifest))
            if manifest
            else ()
        )
        return tuple(part.name for part in parts if part is not None)

    @cached_property
    def placements(self) -> list[Placement]:
        """What the target's WebGPU provider does with each node of the frame, by its tables."""
        tables = [operator_table(name) for name in self.target.operators]
        return placements(self.graph, self.file.proto, tables)

    def inputs_of(self, role: str) -> list[tuple[Input, Tensor]]:
        """Return the declared inputs of ``role`` that the graph has."""
        manifest = self.manifest
        pairs = [
            (i, self.graph.input(i.name)) for i in (manifest.inputs if manifest else ())
        ]
        return [(i, tensor) for i, tensor in pairs if tensor is not None and i.role == role]

    def _output(self, declared: Any) -> Tensor | None:
        return self.graph.output(declared.name) if declared else None


def _output_fields(manifest: Manifest) -> tuple[str, ...]:
    return tuple(type(manifest.outputs).__dataclass_fields__)


def inspect_model(
    file: ModelFile,
    target: Target,
    limits: Limits,
    tolerances: Mapping[str, float] | None = None,
) -> InspectedModel:
    """Read everything that static rules need; a missing manifest is guessed and marked so."""
    graph = read_graph(file)
    text = file.manifest_text
    parsed = parse(text) if text is not None else None
    candidate = infer_manifest(graph, file.path.stem) if parsed is None else None
    return InspectedModel(file, graph, parsed, candidate, target, limits, tolerances or {})
