"""The rule catalogue, one or more modules a family."""

__all__ = ["FAMILIES"]

from gsgen.contract.rules import (
    appearance,
    behaviour,
    capture,
    census,
    covariance,
    declarations,
    extent,
    graph,
    graph_outputs,
    hygiene,
    inputs,
    integers,
    limits,
    manifest,
    outputs,
    safety,
    values,
    visionary,
    waivers,
)

FAMILIES = (
    manifest,
    declarations,
    inputs,
    outputs,
    graph_outputs,
    graph,
    capture,
    integers,
    hygiene,
    values,
    covariance,
    extent,
    appearance,
    behaviour,
    limits,
    census,
    safety,
    visionary,
    waivers,
)
