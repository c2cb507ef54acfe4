"""The rule catalogue, one or more modules a family."""

__all__ = ["FAMILIES"]

from gsgen.contract.rules import (
    appearance,
    behaviour,
    covariance,
    graph,
    inputs,
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
    inputs,
    outputs,
    graph,
    values,
    covariance,
    appearance,
    behaviour,
    limits,
    safety,
    visionary,
    waivers,
)
