"""Rules of determinism (GB): outputs depend only on the inputs, as `depends_on` declares."""

from collections.abc import Iterator

from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.probing.probes import INPUT_PREFIX
from gsgen.contract.probing.run_comparison import Behaviour, Comparison
from gsgen.contract.spec.fields.roles import CAMERA_ROLES, MANIFEST_KINDS
from gsgen.contract.spec.manifest import Input
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation, set_hint
from gsgen.contract.validation.gates import MODEL_RUNS, NOT_RANDOM, REPRODUCIBLE
from gsgen.contract.validation.rule import rule


def _difference_violations(
    comparison: Comparison, expected: str, hint: str = ""
) -> Iterator[Violation]:
    for name, largest in comparison.changed.items():
        actual = f"differs by up to {largest:.3g} at probe {comparison.first!r}"
        yield Violation.at(f"output {name}", actual, expected, hint=hint)


@rule("GB001", Severity.ERROR, needs=(MODEL_RUNS, *NOT_RANDOM), kinds=MANIFEST_KINDS)
def deterministic(behaviour: Behaviour) -> Iterator[Violation]:
    """Two consecutive runs with the same inputs give the same bits.

    Why:
        A still camera would show a flickering picture, and no test could compare results.

    Hint:
        Call model.eval() before the export, which switches Dropout off; draw random numbers before
        export and store them as weights.
    """
    yield from _difference_violations(behaviour.repeated, "the same bits as the run before")


@rule("GB002", Severity.ERROR, needs=("GV025", "GB001"), kinds=MANIFEST_KINDS)
def stateless(behaviour: Behaviour) -> Iterator[Violation]:
    """The same inputs give the same bits, regardless of other runs in between.

    Why:
        Scrubbing back to an earlier time must show the same picture again.

    Hint:
        Make every output a function of the inputs alone.
    """
    if behaviour.revisited_pair is not None:
        expected = "the same bits as before other inputs were run"
        yield from _difference_violations(behaviour.revisited_pair, expected)


@rule("GB003", Severity.WARNING, needs=(*REPRODUCIBLE, "GV054"))
def inputs_matter(behaviour: Behaviour) -> Iterator[Violation]:
    """Each model input changes some output, unless `depends_on` declares that it does not.

    Why:
        An input without effect was usually turned into a constant when the model was traced: the
        avatar does not move, the scene does not change with time. A runtime also skips inference
        where nothing it depends on has changed.

    Hint:
        Export without detaching the input (numpy round trips, `.item()`, Python branches), or set
        "depends_on": {input or role: false}.
    """
    for role, comparisons in behaviour.comparisons_by_role.items():
        if not _does_reach_output(behaviour.subject, role):
            continue  # another rule reports it
        changes = any(comparison.changed for comparison in comparisons)
        location = _location(role)
        if _declares_dependence(behaviour, role) and not (
            changes or _does_zero_change_output(behaviour, role)
        ):
            actual = f"no output changes with it ({len(comparisons)} variations)"
            yield Violation.at(location, actual, "an effect, or depends_on false")


def _inputs_of(subject: InspectedModel, key: str) -> list[Input]:
    """Return the model inputs to which an input role or an input's name refers."""
    inputs = subject.manifest.inputs if subject.manifest else ()
    return [entry for entry in inputs if key in (entry.role, f"{INPUT_PREFIX}{entry.name}")]


def _declares_dependence(behaviour: Behaviour, key: str) -> bool:
    """Return whether the model's outputs may change with any input of an input role."""
    generator = behaviour.subject.generator
    entries = _inputs_of(behaviour.subject, key)
    return generator is None or any(map(generator.depends, entries))


def _is_camera_role(subject: InspectedModel, key: str) -> bool:
    return any(entry.role in CAMERA_ROLES for entry in _inputs_of(subject, key))


def _location(key: str) -> str:
    return key if key.startswith(INPUT_PREFIX) else f"role {key}"


def _does_zero_change_output(behaviour: Behaviour, role: str) -> bool:
    """Return whether an output changes if all inputs of an input role are set to zero."""
    zero_runs = [
        run
        for run in behaviour.trial_runs("edges")
        if run.digest and run.probe.label.endswith(f" with zero {role}")
    ]
    return any(run.digest != behaviour.base.digest for run in zero_runs)


def _does_reach_output(subject: InspectedModel, role: str) -> bool:
    graph = subject.graph
    used_names = {name for tensor in graph.outputs for name in graph.ancestors(tensor.name)[0]}
    return any(entry.name in used_names for entry in _inputs_of(subject, role))


@rule("GB022", Severity.ERROR, needs=REPRODUCIBLE)
def denied_dependence(behaviour: Behaviour) -> Iterator[Violation]:
    """If `depends_on` declares that an input role changes nothing, no output changes with it.

    Why:
        A runtime keeps the result while only such an input changes: the scene stands still, or
        shows the time or pose of an earlier frame.

    Hint:
        Remove the name from "depends_on", or set it to true.
    """
    for role, comparisons in behaviour.comparisons_by_role.items():
        changed = next((c.changed for c in comparisons if c.changed), None)
        is_camera_role = _is_camera_role(behaviour.subject, role)
        if changed and not is_camera_role and not _declares_dependence(behaviour, role):
            actual = f"output {next(iter(changed))} changes with it"
            hint = set_hint(f"depends_on.{role.removeprefix(INPUT_PREFIX)}", True)
            yield Violation.at(_location(role), actual, "depends_on true", hint=hint)


@rule("GB007", Severity.ERROR, needs=REPRODUCIBLE)
def camera_invariance(behaviour: Behaviour) -> Iterator[Violation]:
    """If `depends_on` declares that the camera changes nothing, no output changes with the camera.

    Why:
        A runtime runs such a model once and keeps the result while the camera moves: the picture
        shows what another camera should see.

    Hint:
        Set "depends_on": {"view": true}, or compute the camera-dependent part elsewhere.
    """
    for role, comparisons in behaviour.comparisons_by_role.items():
        if _is_camera_role(behaviour.subject, role) and not _declares_dependence(behaviour, role):
            hint = set_hint(f"depends_on.{role}", True)
            for comparison in comparisons:
                yield from _difference_violations(comparison, f"the same at every {role}", hint)
