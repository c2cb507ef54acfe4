"""Exports of one generator in float32 and in float16 share its traced graph.

Torch takes most of an export's time for it, and both are rewritten from the same float32 graph.
"""

__all__ = ["share_traces"]

from collections.abc import Sequence
from typing import Any

import onnx_ir as ir
import pytest

from gsgen.contract.probing.probes import Probe
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.authoring.output_names import output_names
from gsgen.sdk.authoring.packed_module import PackedGenerator
from gsgen.sdk.exporting import exporter


def share_traces(patch: pytest.MonkeyPatch) -> None:
    """Let exports of the same generator object, at equal inputs and sizes, trace it once."""
    trace = exporter.trace_generator
    traces: dict[Any, tuple[PackedGenerator, ir.Model]] = {}

    def trace_generator(
        packed: PackedGenerator,
        example: Probe,
        manifest: GeneratorManifest,
        opset: int,
        hazards: Sequence[Any] = (),
    ) -> ir.Model:
        color = manifest.outputs.appearance
        values = tuple(
            (name, value.dtype.str, value.shape, value.tobytes())
            for name, value in example.inputs.items()
        )
        # A padded degree of harmonics makes another graph, and so does another storage.
        degree = color and color.degree
        key = (id(packed.generator), packed.packed, tuple(output_names(manifest)), degree)
        key = (*key, opset, values)
        if key not in traces:
            # The generator is stored, too, so that no other one gets its id.
            traces[key] = packed, trace(packed, example, manifest, opset, hazards)
        return traces[key][1].clone()

    patch.setattr(exporter, "trace_generator", trace_generator)
