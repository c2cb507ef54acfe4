"""Explains why an exported model differs from torch: ignored inputs, or untraceable code."""

__all__ = ["Diagnosis", "ParitySuspects", "diagnose", "low_precision_hint"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from gsgen.contract.probing.probes import Probe, dependency_probes
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.exporting.eager_reference import EagerRuns, run_eager, run_in_float64
from gsgen.sdk.exporting.tracing.hazards import Hazard, HazardKind, describe_hazard
from gsgen.sdk.exporting.tracing.operator_watch import OperatorWatch
from gsgen.sdk.exporting.tracing.repeatability import find_unrepeatable
from gsgen.sdk.parity import ModelOutput, references_equal

RunProbes = Callable[[list[Probe]], list[ModelOutput]]
_MAX_LISTED_SUSPECTS = 3

_NOT_REWRITTEN_TEXT = (
    "The graph was not rewritten, and runtimes compute some of torch's operators differently: "
    "export with rewrites."
)
_UNSTABLE_HINT = (
    "Eager torch differs as much between float32 and float64: forward loses its digits, for example "
    "in a difference of large numbers or a division by nearly zero. Compute it in another order, "
    "with smaller numbers, or once, in __init__, in float64."
)
_UNTRACED_HINT = (
    "No operation of forward was seen to leave torch. Look for values that are computed from "
    "inputs outside of torch"
)
_UNKNOWN_HINT = f"{_UNTRACED_HINT}; without such a value, a kernel differs: please report it."
# Eager torch counts as stable if float32 and float64 agree this closely, relatively.
_STABLE_TOLERANCE = 1e-3


@dataclass(frozen=True, slots=True)
class ParitySuspects:
    """Possible causes of a difference between an exported model and its torch module."""

    generator: GaussianGenerator  # the module
    traced: Probe  # the inputs that it was traced with
    hazards: Sequence[Hazard]  # operations in it that tracing cannot follow
    rewritten: bool  # whether the graph was rewritten


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The cause of a difference between an exported model and its torch module."""

    reason: str  # a part of a sentence; empty if unknown
    hint: str  # what to change
    where: str = ""  # the line of the module; empty if unknown


def diagnose(
    suspects: ParitySuspects, manifest: GeneratorManifest, references: EagerRuns, run: RunProbes
) -> Diagnosis:
    """Return why an exported model differs from torch."""
    if cause := _unrepeatable_cause(suspects, references.probes[-1]):
        return cause
    lost_roles = _lost_inputs(suspects, manifest, references, run)
    reason = f"; {' and '.join(lost_roles)} has no effect in the model" if lost_roles else ""
    if low_precision := low_precision_hint(suspects.generator, references.probes[-1]):
        return Diagnosis(reason, "\n  ".join([low_precision, *map(str, suspects.hazards[:2])]))
    if suspects.hazards:
        # A layer in training mode explains a difference best, equal keys of a sort least.
        first, *others = sorted(
            suspects.hazards, key=lambda hazard: (hazard.kind != "training", hazard.kind == "order")
        )
        hint = "\n  ".join([first.hint, *map(str, others[: _MAX_LISTED_SUSPECTS - 1])])
        return Diagnosis(f"; {first.description}{reason}", hint, first.where)
    return Diagnosis(reason, _hint_without_line(suspects, references))


def _unrepeatable_cause(suspects: ParitySuspects, probe: Probe) -> Diagnosis | None:
    """Return the line whose result changes although the inputs do not; None without one."""
    tensors = [torch.from_numpy(np.array(value)) for value in probe.inputs.values()]
    unrepeatable = find_unrepeatable(suspects.generator, tensors)
    if unrepeatable is None:
        return None
    kinds: list[HazardKind] = [
        hazard.kind
        for hazard in suspects.hazards
        if unrepeatable.where and unrepeatable.where in hazard.where
    ]
    where = unrepeatable.where
    kind = kinds[0] if kinds else "random" if unrepeatable.is_random else "changing"
    if "training" in kinds:  # dropout draws random numbers, too
        kind = "training"
        where = next(hazard.where for hazard in suspects.hazards if hazard.kind == kind)
    description, hint = describe_hazard(kind)
    return Diagnosis(f"; {description}", hint, where)


def low_precision_hint(generator: GaussianGenerator, probe: Probe) -> str:
    """Return the line of forward that computes below float32, and what to write; empty if none."""
    with OperatorWatch() as watch:
        run_eager(generator, probe, checked=False)
    return watch.precision_hint


def _hint_without_line(suspects: ParitySuspects, references: EagerRuns) -> str:
    if not suspects.rewritten:
        return _NOT_REWRITTEN_TEXT
    is_stable = _is_stable(suspects.generator, references)
    if is_stable is None:
        return f"{_UNTRACED_HINT}, or for digits that float32 loses."
    return _UNKNOWN_HINT if is_stable else _UNSTABLE_HINT


def _is_stable(generator: GaussianGenerator, references: EagerRuns) -> bool | None:
    """Return whether a torch generator agrees in float32 and float64; None if float64 fails."""
    for reference in references:
        float64_outputs = run_in_float64(generator, reference.probe)
        if float64_outputs is None:
            return None
        if not references_equal(reference, float64_outputs, _STABLE_TOLERANCE):
            return False
    return True


def _lost_inputs(
    suspects: ParitySuspects, manifest: GeneratorManifest, references: EagerRuns, run: RunProbes
) -> list[str]:
    """Return the input roles that have an effect in torch, but not in the exported model."""
    probe_of_trace, far_probe = suspects.traced, references.probes[-1]
    changed_probes = [
        (role, probe)
        for role, probes in dependency_probes(manifest, probe_of_trace, (far_probe,))
        for probe in probes
    ]
    if not changed_probes:
        return []
    probes = [probe_of_trace, *(probe for _, probe in changed_probes)]
    outputs_of_runs = run(probes)
    expected = [run_eager(suspects.generator, probe, checked=False) for probe in probes]
    return [
        role
        for (role, _), outputs, reference in zip(
            changed_probes, outputs_of_runs[1:], expected[1:], strict=True
        )
        if _are_outputs_equal(outputs_of_runs[0], outputs)
        and not references_equal(expected[0], reference)
    ]


def _are_outputs_equal(a: ModelOutput, b: ModelOutput) -> bool:
    pairs = [(a.rows, b.rows), (a.color, b.color)]
    if a.cells is not None and b.cells is not None:
        pairs.append((a.cells, b.cells))
    arrays = all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)
    return arrays and a.count == b.count
