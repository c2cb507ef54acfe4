"""The rule catalogue, one module a family."""

__all__ = ["FAMILIES"]

from gsgen.contract.rules import (
    behaviour,
    graph,
    inputs,
    limits,
    manifest,
    outputs,
    safety,
    values,
    visionary,
)

FAMILIES = (manifest, inputs, outputs, graph, values, behaviour, limits, safety, visionary)
