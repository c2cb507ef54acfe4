"""Operators that torch's exporter does not translate, run by ONNX Runtime against torch."""

import numpy as np
import onnx_ir as ir
import onnxruntime
import torch

from gsgen.contract.probing.probes import Probe
from gsgen.sdk.exporting.tracing.trace import TensorNames, trace_module

EDGES = torch.tensor([[-1.0, 0.0, 0.5, 0.5, 2.0], [-2.0, -2.0, 0.0, 1.0, 3.0]])


class Untranslated(torch.nn.Module):
    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return (
            torch.searchsorted(EDGES[0], x),
            torch.searchsorted(EDGES[0], x, right=True),
            torch.searchsorted(EDGES, x, side="right"),
            torch.cumprod(x, dim=1),
            torch.cumprod(x, dim=0),
        )


def test_translations_give_what_torch_gives() -> None:
    x = torch.randn(2, 7, generator=torch.Generator().manual_seed(0))
    x[0, :5] = EDGES[0]  # values on an edge: left and right differ
    names = TensorNames(("x",), ("left", "right", "rows", "across", "down"))
    probe = Probe(label="x", inputs={"x": x.numpy()})
    model = trace_module(Untranslated(), probe, names, 18, where="Untranslated")
    data = ir.serde.serialize_model(model).SerializeToString()
    results = onnxruntime.InferenceSession(data).run(None, {"x": x.numpy()})
    for result, expected in zip(results, Untranslated()(x), strict=True):
        assert result.dtype == expected.numpy().dtype
        np.testing.assert_allclose(result, expected.numpy(), rtol=1e-6)
