"""Say why an export went wrong: which input lost its effect, and which lines may be the cause."""

__all__ = ["Suspects", "explain"]

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gsgen.contract.probing.probes import Probe, dependency_probes
from gsgen.contract.spec.manifest import GeneratorManifest
from gsgen.sdk.authoring.generator import GaussianGenerator
from gsgen.sdk.exporting.eager_reference import run_eager
from gsgen.sdk.exporting.trace_hazards import Hazard
from gsgen.sdk.parity import ModelOutput, Reference, same

Run = Callable[[list[Probe]], list[ModelOutput]]
_MOST = 3

_RANDOM = (
    "forward gives another result for the same inputs: it draws random numbers, reads a clock, "
    "or keeps something between frames."
)
_PLAIN = (
    "The graph was not rewritten, and runtimes compute some of what torch writes otherwise: "
    "export with rewrites."
)
_UNKNOWN = (
    "Nothing in forward was seen to leave torch. Look for values that are computed from inputs "
    "outside of torch; if there are none, a kernel differs: please report it."
)


@dataclass(frozen=True, slots=True)
class Suspects:
    """What may be why an exported model computes something else.

    Attributes:
        generator: The module.
        traced: The inputs that it was traced with.
        hazards: What was seen while it ran.
        rewritten: Whether the graph was rewritten.
    """

    generator: GaussianGenerator
    traced: Probe
    hazards: Sequence[Hazard]
    rewritten: bool


def explain(
    suspects: Suspects, manifest: GeneratorManifest, references: list[Reference], run: Run
) -> tuple[str, str]:
    """Return what goes on behind a difference, as a part of a sentence, and how to mend it.

    Args:
        suspects: What is known.
        manifest: What the model declares.
        references: What eager torch gave.
        run: Runs the exported model.
    """
    lost = _lost_inputs(suspects, manifest, references, run)
    reason = f"; {' and '.join(lost)} changes nothing in the model" if lost else ""
    return reason, _mend(suspects, references)


def _mend(suspects: Suspects, references: list[Reference]) -> str:
    if suspects.hazards:
        return "\n  ".join(str(one) for one in suspects.hazards[:_MOST])
    again = run_eager(suspects.generator, references[-1].probe)
    if not same(references[-1], again):
        return _RANDOM
    return _UNKNOWN if suspects.rewritten else _PLAIN


def _lost_inputs(
    suspects: Suspects, manifest: GeneratorManifest, references: list[Reference], run: Run
) -> list[str]:
    """Return the roles that change something in torch and nothing in the model."""
    base, far = suspects.traced, references[-1].probe
    varied = [
        (role, probe)
        for role, probes in dependency_probes(manifest, base, (far,))
        for probe in probes
    ]
    if not varied:
        return []
    probes = [base, *(probe for _, probe in varied)]
    made = run(probes)
    known = [run_eager(suspects.generator, probe) for probe in probes]
    return [
        role
        for (role, _), outputs, reference in zip(varied, made[1:], known[1:], strict=True)
        if _equal(made[0], outputs) and not same(known[0], reference)
    ]


def _equal(a: ModelOutput, b: ModelOutput) -> bool:
    pairs = [(a.rows, b.rows), (a.color, b.color)]
    if a.cells is not None and b.cells is not None:
        pairs.append((a.cells, b.cells))
    arrays = all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)
    return arrays and a.count == b.count
