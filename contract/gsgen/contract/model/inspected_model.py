"""The input of static rules: an ONNX model's graph together with its manifest."""

__all__ = ["InspectedModel", "inspect_model", "raised_to_installed"]

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from onnx import ModelProto

from gsgen.contract.model.graph import Graph, Tensor, read_graph
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
from gsgen.contract.spec.manifest_io import Candidate, ParsedManifest, parse
from gsgen.contract.spec.onnx_facts import MAIN_DOMAIN
from gsgen.contract.spec.operator_tables import operator_table
from gsgen.contract.spec.targets import Target


@dataclass(frozen=True, kw_only=True)
class InspectedModel:
    """A model whose file, graph and manifest have been read.

    Attributes:
        file: The opened file.
        graph: Its graph.
        parsed: The result of parsing the embedded manifest; None without a manifest.
        candidate: The inferred manifest; None where a manifest is embedded.
        target: The consumer whose requirements apply.
        limits: Time and memory for running it, as set by the user.
        tolerances: Tolerances set by the user, by field; they override the manifest.
    """

    file: ModelFile
    graph: Graph
    parsed: ParsedManifest | None
    candidate: Candidate | None
    target: Target
    limits: Limits
    tolerances: Mapping[str, float] = field(default_factory=dict)

    @property
    def manifest(self) -> Manifest | None:
        """The model's manifest: the embedded one, else the inferred one, or None."""
        if self.parsed is not None:
            return self.parsed.manifest
        return self.candidate.manifest if self.candidate else None

    @cached_property
    def sandbox_limits(self) -> Limits:
        """The time and memory limits for running the model, with memory added for its weights."""
        return self.limits.for_model(self.file.weight_bytes)

    @property
    def declared_version(self) -> str:
        """The contract version that the model's manifest declares; empty if missing."""
        version = self.parsed.version if self.parsed else None
        return f"{version[0]}.{version[1]}" if version else ""

    @property
    def kind(self) -> str:
        """The model's kind, such as gaussian-generator; inferred if there is no manifest."""
        manifest = self.manifest
        return manifest.kind if manifest else ""

    @property
    def generator(self) -> GeneratorManifest | None:
        """The manifest of a Gaussian Generator; None for other kinds of model."""
        return self.manifest if isinstance(self.manifest, GeneratorManifest) else None

    @cached_property
    def declared_gaussians(self) -> GaussiansOutput | None:
        """The manifest's declaration of the output that holds packed Gaussians."""
        return self.generator.outputs.gaussians if self.generator else None

    @cached_property
    def declared_appearance(self) -> AppearanceOutput | None:
        """The manifest's declaration of the appearance (colour) output."""
        return self.generator.outputs.appearance if self.generator else None

    @cached_property
    def declared_count(self) -> CountOutput | None:
        """The manifest's declaration of the output with the number of Gaussians."""
        return self.generator.outputs.count if self.generator else None

    @cached_property
    def declared_cells(self) -> CellsOutput | None:
        """The manifest's declaration of the output with cells (groups of Gaussians to blend)."""
        return self.generator.outputs.cells if self.generator else None

    @property
    def gaussians(self) -> Tensor | None:
        """The graph output that holds the packed Gaussians."""
        return self._output(self.declared_gaussians)

    @property
    def appearance(self) -> Tensor | None:
        """The graph output that holds the appearance (colours) of the Gaussians."""
        return self._output(self.declared_appearance)

    @property
    def count(self) -> Tensor | None:
        """The graph output that holds the number of Gaussians (row count)."""
        return self._output(self.declared_count)

    @property
    def cells(self) -> Tensor | None:
        """The graph output that holds the cells (groups of Gaussians) for weighted blending."""
        return self._output(self.declared_cells)

    @cached_property
    def declared_outputs(self) -> tuple[tuple[str, str], ...]:
        """The path in the manifest and the name of each declared output, in its order."""
        manifest = self.manifest
        parts = (
            [(field, getattr(manifest.outputs, field)) for field in _output_fields(manifest)]
            if manifest
            else []
        )
        return tuple((f"outputs.{field}", part.name) for field, part in parts if part is not None)

    @cached_property
    def output_names(self) -> tuple[str, ...]:
        """The names of all outputs that the manifest declares, in the order of the manifest."""
        return tuple(name for _, name in self.declared_outputs)

    @cached_property
    def placements(self) -> list[Placement]:
        """Where the WebGPU provider is predicted to run each node of a frame: GPU or CPU."""
        tables = [operator_table(name) for name in self.target.operators]
        return placements(self.graph, self.file.proto, tables)

    def inputs_of(self, role: str) -> list[tuple[Input, Tensor]]:
        """Return the model inputs that the manifest declares with the input role ``role``."""
        manifest = self.manifest
        pairs = [(i, self.graph.input(i.name)) for i in (manifest.inputs if manifest else ())]
        return [(i, tensor) for i, tensor in pairs if tensor is not None and i.role == role]

    def path_of(self, entry: Input) -> str:
        """Return the path of a declared input in the manifest, such as ``inputs.0``."""
        return f"inputs.{(self.manifest.inputs if self.manifest else ()).index(entry)}"

    def _output(self, declared: Any) -> Tensor | None:
        return self.graph.output(declared.name) if declared else None


def _output_fields(manifest: Manifest) -> tuple[str, ...]:
    return tuple(type(manifest.outputs).__dataclass_fields__)


def raised_to_installed(target: Target, proto: ModelProto) -> Target:
    """Return a target whose upper bounds are the installed ONNX Runtime's, if a model needs them.

    Only targets that follow the installed runtime are raised, and only for a model that exceeds the
    bounds of the data file: ONNX Runtime is imported for such models alone.
    """
    low, high = target.opset
    main = (entry.version for entry in proto.opset_import if entry.domain in MAIN_DOMAIN)
    is_supported = max(main, default=0) <= high and proto.ir_version <= target.ir
    if is_supported or not target.follows_runtime:
        return target
    from gsgen.contract.model.installed_runtime import installed_bounds

    opset, ir = installed_bounds()
    return replace(target, opset=(low, max(high, opset)), ir=max(target.ir, ir))


def inspect_model(
    file: ModelFile, target: Target, limits: Limits, tolerances: Mapping[str, float] | None = None
) -> InspectedModel:
    """Read the graph and the manifest of a model file; a missing manifest is inferred."""
    graph = read_graph(file)
    text = file.manifest_text
    parsed = parse(text) if text is not None else None
    candidate = None
    if parsed is None:
        from gsgen.contract.model.manifest_inference import infer_manifest

        candidate = infer_manifest(graph, file.path.stem)
    return InspectedModel(
        file=file,
        graph=graph,
        parsed=parsed,
        candidate=candidate,
        target=raised_to_installed(target, file.proto),
        limits=limits,
        tolerances=tolerances or {},
    )
