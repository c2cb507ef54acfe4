"""Generators as torch exports them, before anything is rewritten, checked or compared."""

from dataclasses import dataclass

import onnx_ir as ir
import torch

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.manifest import Bounds, GeneratorManifest
from gsgen.sdk import GaussianGenerator
from gsgen.sdk.authoring.packed_module import Packed, PackedGenerator
from gsgen.sdk.exporting.pipeline import probes_of
from gsgen.sdk.exporting.prepare import BOUNDS_PROBES, manifest_of
from gsgen.sdk.exporting.tracing.trace import trace_generator


@dataclass(frozen=True)
class Traced:
    """A graph, the module that it came from, and what they say of themselves."""

    model: ir.Model
    module: PackedGenerator
    manifest: GeneratorManifest
    probes: tuple[Probe, ...]


def traced(generator: GaussianGenerator, name: str, rows: int, degree: int | None) -> Traced:
    """Trace a generator of ``rows`` Gaussians; ``degree`` is that of its SH, None for RGB."""
    bounds = Bounds((-3.0, -3.0, -3.0), (3.0, 3.0, 3.0))
    manifest = manifest_of(generator.eval(), name, "float32", degree, rows, bounds)
    probes = probes_of(manifest, count=BOUNDS_PROBES)
    module = PackedGenerator(generator, Packed(torch.float32, rows))
    graph = trace_generator(module, probes[1], manifest, 18).model
    return Traced(graph, module, manifest, probes)
