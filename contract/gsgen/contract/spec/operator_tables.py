"""Operator tables: how releases of ONNX Runtime's WebGPU provider execute each ONNX operator.

Measured, not read from its documentation, and written by ``scripts/write_operator_tables.py``.
"""

__all__ = ["FAILED_OUTCOMES", "OperatorTable", "operator_table"]

import json
from dataclasses import dataclass
from functools import cache
from importlib import resources

from gsgen.contract.errors import UnknownName

# Outcomes of a node under graph capture, in words, besides the good one, ``capture``.
FAILED_OUTCOMES = {
    "stale": "runs, but repeats the first frame",
    "cpu": "falls to the CPU",
    "wrong": "runs, but computes something else",
    "run_error": "fails at the first frame",
    "error": "keeps the session from loading",
    "control_flow": "is refused as control flow",
}
GRAPH_CAPTURE = "capture"


@dataclass(frozen=True, slots=True)
class OperatorTable:
    """How one WebGPU runtime release executes each ONNX operator (captured, CPU fallback, …).

    Attributes:
        runtime: The release, as reports show it.
        outcomes: (operator, dtype) → operator set from which on → outcome. The operator may have
            a variant in its name, such as ``Slice/backwards``.
    """

    runtime: str
    outcomes: dict[tuple[str, str], dict[int, str]]

    def outcome(self, operator: str, variant: str, dtype: str, opset: int) -> str:
        """Return how this runtime release executes an ONNX operator; empty if not measured."""
        steps = self.outcomes.get((f"{operator}/{variant}", dtype)) if variant else None
        steps = steps or self.outcomes.get((operator, dtype))
        if not steps:
            return ""
        earlier_opsets = [step for step in steps if step <= opset] or [min(steps)]
        return steps[max(earlier_opsets)]

    def opset_with_kernel(self, operator: str, variant: str, dtype: str) -> int | None:
        """Return an opset in which this runtime's graph capture supports an operator, or None."""
        steps = self.outcomes.get((f"{operator}/{variant}", dtype)) if variant else None
        steps = steps or self.outcomes.get((operator, dtype), {})
        return next((step for step, outcome in steps.items() if outcome == GRAPH_CAPTURE), None)


@cache
def operator_table(name: str) -> OperatorTable:
    """Return the operator table of a runtime release, such as ``onnxruntime-web-1.22.0``.

    Raises:
        UnknownName: No table has that name.
    """
    folder = resources.files("gsgen.contract").joinpath("targets_data", "operators")
    file = folder.joinpath(f"{name}.json")
    if not file.is_file():
        known = [entry.name.removesuffix(".json") for entry in folder.iterdir()]
        raise UnknownName.among("operator table", name, known)
    data = json.loads(file.read_text("utf-8"))
    outcomes = {
        (operator, dtype): {int(opset): outcome for opset, outcome in steps.items()}
        for operator, groups in data["operators"].items()
        for dtypes, steps in groups.items()
        for dtype in dtypes.split()
    }
    return OperatorTable(data["runtime"], outcomes)
