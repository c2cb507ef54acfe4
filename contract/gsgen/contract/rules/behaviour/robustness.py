"""GB and GI, robustness: edges of inputs, another optimiser, another order of runs."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from gsgen.contract.probing.behaviour_probes import AGAIN
from gsgen.contract.probing.outputs import ModelOutputs, read_outputs
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRun, difference
from gsgen.contract.probing.test_vectors import MOST_SEEDS, probed_seeds, vector_label
from gsgen.contract.spec.layout import OPACITY
from gsgen.contract.spec.manifest import TestVector
from gsgen.contract.spec.roles import KINDS
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.agreement import FieldError, apart, comparable
from gsgen.contract.validation.finding import Location, Violation
from gsgen.contract.validation.rule import rule
from gsgen.contract.validation.tolerances import effective_tolerances

_RUNS = ("GV025", "GB001", "GB002")
_FINITE = ("GV001", "GV002", "GI009")

# What rewriting a graph may change by rounding, relative to an output's largest value.
_REWRITTEN = 1e-2
_INERT_SHARE = 0.5
_MOSTLY_DEAD = 0.9


def _broken(visits: list[ProbeRun]) -> Iterator[Violation]:
    for visit in visits:
        if visit.error:
            yield Violation.at(
                "ONNX Runtime", f"{visit.error} ({visit.probe.label})", "no error"
            )
        for name in visit.not_finite:
            yield Violation.at(
                f"output {name}", f"not finite at {visit.probe.label!r}", "finite values"
            )


@rule(
    "GB013",
    "edges-finite",
    Severity.ERROR,
    over="runs",
    fixture="nan_at_half_a_turn",
    needs=(*_RUNS, *_FINITE),
)
def edges_finite(behaviour: Behaviour) -> Iterator[Violation]:
    """Every output is finite while one input is all zero, and at both ends of all ranges.

    Why:
        A rest pose is all zeros, a slider rests at its end, a joint turns by half a circle: norms
        of zero and logarithms of zero hide there.

    Hint:
        Clamp under the square root, and before division and logarithm.
    """
    yield from _broken(behaviour.visits("edges"))


@rule(
    "GI010",
    "beyond-range-finite",
    Severity.WARNING,
    over="runs",
    fixture="nan_beyond_range",
    needs=(*_RUNS, *_FINITE, "GB013"),
)
def beyond_range_finite(behaviour: Behaviour) -> Iterator[Violation]:
    """Just outside the declared ranges, every output is finite and nothing fails.

    Why:
        Timelines overshoot by a rounding error, and sliders by a pixel. An index computed from time
        then lies outside its table, and the whole frame fails.

    Hint:
        Clip inputs to their range inside the model.
    """
    yield from _broken(behaviour.visits("outside"))


@rule(
    "GB010",
    "optimiser-agrees",
    Severity.WARNING,
    over="runs",
    fixture="optimised_wrongly",
    needs=(*_RUNS, "GG020"),
    kinds=KINDS,
)
def optimiser_agrees(behaviour: Behaviour) -> Iterator[Violation]:
    """With the optimisations of ONNX Runtime switched off, outputs agree within the tolerances.

    Why:
        Optimisers rewrite graphs, and some rewrites are wrong or amplify rounding. Every runtime
        and every release has others, so such a model shows something else elsewhere. Packed rows
        and cells are compared field by field with the tolerances of the configuration, else the
        manifest's, else the contract's; other outputs by one hundredth of their largest value.

    Hint:
        Find the operators by switching optimisations off one by one; write that part differently.
        Widen the tolerances only if the difference cannot be seen.
    """
    subject, base = behaviour.subject, behaviour.base
    tolerances = effective_tolerances(subject)
    for visit in behaviour.visits("plain"):
        if not visit.outputs:
            continue
        first, second = (
            read_outputs(subject, one.probe.label, False, one.outputs)
            for one in (base, visit)
        )
        for one in apart(first, second, tolerances):
            yield _too_far(one, first)
        parts = (
            subject.declared_gaussians,
            subject.declared_appearance,
            subject.declared_cells,
        )
        both = zip(parts, comparable(first, second), strict=True)
        compared = {part.name for part, judged in both if part is not None and judged}
        for name, value in base.outputs.items():
            if name not in compared and name in visit.outputs:
                yield from _loosely(name, value, visit.outputs[name])


def _too_far(one: FieldError, emission: ModelOutputs) -> Violation:
    tolerance, field = one.tolerance, one.tolerance.field
    output = emission.color_place if field == "appearance" else emission.rows_place
    if one.of_cells:
        output = emission.cells_place
        field = "visibility" if field == "opacity" else field
    place = Location(output, field)
    actual = f"row {one.row} differs by {one.error:.3g} without optimisations"
    source = {"default": "the contract's own", "config": "by the configuration"}
    expected = (
        f"{tolerance.value:g} at most, {tolerance.unit} "
        f"({source.get(tolerance.source, 'by the manifest')})"
    )
    return Violation(place, expected, actual)


def _loosely(name: str, value: np.ndarray, other: np.ndarray) -> Iterator[Violation]:
    """Compare an output that no tolerance speaks of, in the scale of its largest value."""
    peak = float(np.abs(value.astype(np.float64)).max(initial=0))
    least = 1.0 if value.dtype.kind in "iu" else 0.0
    largest = difference(value, other)
    if largest > max(_REWRITTEN * peak, least):
        actual = f"differs by up to {largest:.3g} without optimisations"
        expected = f"{_REWRITTEN * peak:.3g} at most, 1 % of the largest value"
        yield Violation.at(f"output {name}", actual, expected)


@rule(
    "GB012",
    "order-does-not-matter",
    Severity.INFO,
    over="runs",
    fixture="remembers_after_a_while",
    needs=_RUNS,
    kinds=KINDS,
)
def order_does_not_matter(behaviour: Behaviour) -> Iterator[Violation]:
    """After all other runs, the probes give the same bits in reverse order.

    Why:
        What is remembered from run to run may show only after a while.

    Hint:
        Make every output a function of the inputs alone.
    """
    first = {one.probe.label: one.digest for one in behaviour.values}
    for visit in behaviour.visits("again"):
        label = visit.probe.label.removesuffix(f" {AGAIN}")
        if visit.digest and visit.digest != first[label]:
            yield Violation.at(
                f"probe {label!r}", "other bits than at first", "the same bits"
            )


@rule(
    "GB009",
    "live-rows-first",
    Severity.INFO,
    over="runs",
    fixture="mostly_inert",
    needs=("GV025", "GO001", "GO002", "GO010", "GO011", "GV016", "GV003"),
)
def live_rows_first(behaviour: Behaviour) -> Iterator[Violation]:
    """An exact count counts rows that are drawn: most of them are not fully transparent.

    Why:
        A renderer sorts and visits all rows before an exact count. If most are inert, the live ones
        do not stand first, and the count saves nothing.

    Hint:
        Move live rows to the front, or declare the count's semantics as "upper-bound".
    """
    subject = behaviour.subject
    declared, count = subject.declared_gaussians, subject.declared_count
    if declared is None or count is None or count.semantics != "exact":
        return
    for probe, outputs in behaviour.emitted:
        live = max(0, int(outputs[count.name].reshape(-1)[0]))
        opacity = outputs[declared.name][:live, OPACITY]
        inert = int(np.count_nonzero(opacity == 0))
        # If nearly all are, another rule says so.
        if _INERT_SHARE * len(opacity) < inert <= _MOSTLY_DEAD * len(opacity):
            actual = (
                f"{inert} of {len(opacity)} counted rows have opacity 0 at {probe.label!r}"
            )
            yield Violation.at(f"output {count.name}", actual, "live rows first")
            return


@rule(
    "GM012",
    "test-vectors-reproduce",
    Severity.WARNING,
    over="runs",
    fixture="test_vector_differs",
    needs=(*_RUNS, "GM002", "GM003"),
    kinds=KINDS,
)
def vectors_reproduce(behaviour: Behaviour) -> Iterator[Violation]:
    """Every test vector names a probe, and the model gives the outputs that it promises.

    Why:
        A vector tells whoever downloads the model that it runs as it did at its author's. The
        digest is SHA-256 over the declared outputs in order: a line "name dtype shape", then the
        bytes. Another processor may round differently, so a difference is no proof of a fault.

    Hint:
        Take the digest given here, if the model is right. Models without vectors are fine.
    """
    manifest = behaviour.subject.manifest
    for index, vector in enumerate(manifest.test_vectors if manifest else ()):
        place, given = f"manifest test_vectors.{index}", _outcome(behaviour, vector)
        if isinstance(given, Violation):
            yield replace(given, where=Location(place))
        elif given != vector.expected_sha256:
            expected = f"the declared {vector.expected_sha256}"
            yield Violation.at(place, f"sha256 {given}", expected, certainty="possible")


def _outcome(behaviour: Behaviour, vector: TestVector) -> str | Violation:
    """Return the digest of what the vector's probe gave, or why there is none."""
    manifest, plan = behaviour.subject.manifest, behaviour.trial.plan
    assert manifest is not None
    label, ours = vector_label(vector.inputs, vector.seed), vector.seed == plan.seed
    if not ours and vector.seed not in probed_seeds(manifest, plan.seed):
        return Violation.at("", f"seed {vector.seed}", f"{MOST_SEEDS} other seeds at most")
    visits = behaviour.values if ours else behaviour.visits("vectors")
    digests = {one.probe.label: one.digest for one in visits}
    given = digests.get(vector.inputs if ours else label)
    if given:
        return given
    known = [one.probe.label for one in behaviour.values]
    planned = [plan.probes[index].label for index in plan.trials.get("vectors", ())]
    if not ours and label in planned:
        actual = f"no outputs at {label!r}"
        return Violation.at("", actual, "a run in time", certainty="possible")
    actual = f"no probe {vector.inputs!r} with seed {vector.seed}"
    return Violation.at("", actual, f"one of {', '.join(map(repr, known))}")
