"""Validates a model in stages: file, graph, outputs for test inputs, and behaviour."""

__all__ = ["Progress", "ignore_progress", "validate_with"]

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gsgen.contract._entry_points import plugin_exits_as_errors
from gsgen.contract.errors import HostProcessFailed
from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.drawn_sample import MIN_DRAWN_ROWS, draw_sample
from gsgen.contract.probing.outputs import ModelOutputs, Rows, chunks, read_outputs
from gsgen.contract.probing.probe_plan import fetched_outputs, make_plan, maps_weights
from gsgen.contract.probing.run_comparison import (
    Behaviour,
    ProbeRuns,
    isolated_views,
    read_behaviour,
)
from gsgen.contract.probing.sandbox import Run, execute
from gsgen.contract.process.interrupts import OutOfTime
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.digest import digest
from gsgen.contract.validation.finding import Finding, Violation
from gsgen.contract.validation.gates import AT_MOMENTS, MODEL_RUNS
from gsgen.contract.validation.level_backend import LevelBackend, LevelUnavailable
from gsgen.contract.validation.outcomes import ResultCollector
from gsgen.contract.validation.report import LevelOutcome, Report
from gsgen.contract.validation.rule import Check, Registry, Rule, Scope, in_dependency_order
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validation.tolerances import effective_tolerances
from gsgen.contract.validation.waivers import Review, apply_waivers

# Called with a short text at the start of each stage.
Progress = Callable[[str], None]

_MISSING_BACKEND = {
    Level.LIVE: "no installed package checks it; it needs gsgen[live]",
    Level.RENDER: "no installed package checks it; it needs gsgen[runtime]",
}
# Levels that a registered backend runs, and the scope of their rules.
_BACKEND_SCOPES: dict[Level, Scope] = {Level.LIVE: "live", Level.RENDER: "render"}


_version = cache(version)  # each call reads a metadata file


def ignore_progress(_: str) -> None:
    """Ignore a progress message: the default progress callback of a validation."""


def validate_with(
    registry: Registry,
    path: str | os.PathLike[str],
    settings: Settings,
    *,
    progress: Progress = ignore_progress,
) -> Report:
    """Validate a model file by the rules of a registry, and return the report.

    Args:
        registry: The rules, and the backends of further levels.
        path: An ONNX file.
        settings: Level, target, limits and severities.
        progress: Called with a short text at the start of each stage.

    Raises:
        ModelUnreadable: The file is not an ONNX model.
    """
    return _Validation(Path(path), settings, registry, progress).report()


class _Validation:
    """Validates one model in stages; each method is a stage."""

    def __init__(
        self, path: Path, settings: Settings, registry: Registry, progress: Progress
    ) -> None:
        self.start_time = time.perf_counter()
        self.settings = settings = settings.for_model(path)
        self.progress = progress
        self.progress(f"reading {path.name}")
        self.registry = registry
        file = open_model(path)
        self.subject = inspect_model(file, settings.target, settings.limits, settings.tolerances)
        self.results = ResultCollector(
            registry=self.registry, settings=settings, kind=self.subject.kind
        )
        self.levels = [LevelOutcome(level=Level.STATIC, ran=True)]
        self.finished_level = Level.STATIC
        self.probes: tuple[str, ...] = ()
        self.moments: tuple[str, ...] = ()
        self.environment = {"onnx": _version("onnx")}
        self.runtime_seconds = 0.0
        self.runs: dict[Level, list[float]] = {}  # the durations of model runs

    def report(self) -> Report:
        """Run the validation stages up to the requested level, and return the report."""
        self._check_model()
        try:
            self._check_runs()
        except OutOfTime as error:
            error.guard.cancel()
            self._leave_unfinished_levels(f"not checked: {error}")
        self._settle_remaining_levels()
        self.results.withdraw_predictions()
        self.results.withdraw_consequences()
        self._check_report()
        subject, gaussians = self.subject, self.subject.declared_gaussians
        manifest = subject.manifest
        return Report(
            path=str(subject.file.path),
            size=subject.file.size,
            kind=subject.kind,
            name=manifest.name if manifest and subject.parsed else "",
            contract=subject.declared_version if manifest else "",
            capacity=gaussians.capacity if gaussians else None,
            target=self.settings.target,
            level=self.settings.level,
            fail_on=self.settings.fail_on,
            findings=self._collect_findings(),
            outcomes=tuple(self.results.outcomes[id] for id in self.registry.rules),
            levels=tuple(self._with_runtime(level) for level in self.levels),
            probes=self.probes,
            moments=self.moments,
            environment=self.environment,
            settings=self.settings.source,
            seconds=time.perf_counter() - self.start_time,
            runtime_seconds=self.runtime_seconds,
            sha256=digest(subject.file.path, self.settings.level, subject.file.size),
            tolerances=effective_tolerances(subject),
            external_size=subject.file.weight_bytes - subject.file.size,
            required=self.settings.required,
            selected=self.settings.only,
            timed=self.settings.timings,
            docs_url=self.settings.docs_url,
        )

    def _collect_findings(self) -> tuple[Finding, ...]:
        return apply_waivers(self.results.findings(), self.settings.waivers, self.settings.today)

    def _with_runtime(self, level: LevelOutcome) -> LevelOutcome:
        """Return a validation level's outcome with the number of model runs and the time taken."""
        outcomes = self.results.outcomes.values()
        rules = sum(o.milliseconds for o in outcomes if o.rule.level is level.level) / 1000
        runs = self.runs.get(level.level, [])
        return replace(level, runs=len(runs), seconds=sum(runs) + rules)

    def _rules_of_scope(self, *scopes: Scope, max_level: Level) -> list[Rule]:
        rules = self.registry.rules.values()
        return [rule for rule in rules if rule.scope in scopes and rule.level <= max_level]

    def _check_model(self) -> None:
        for rule in in_dependency_order(self._rules_of_scope("model", max_level=Level.STATIC)):
            if self.results.is_ready(rule):
                self.results.check(rule, self.subject)
                self.results.settle([rule], items=1)

    def _check_runs(self) -> None:
        level = self.settings.level
        if level < Level.VALUES:
            return
        prerequisite_rules = in_dependency_order(
            self._rules_of_scope("execution", max_level=Level.VALUES)
        )
        if not self._require_runnable_level(prerequisite_rules):
            return
        plan = make_plan(self.subject, level, self.settings.seed)
        self.probes = tuple(probe.label for probe in plan.probes[: plan.values])
        self.progress(f"running {len(plan.probes)} probes in ONNX Runtime")
        path, names = self.subject.file.path, fetched_outputs(self.subject)
        rows, count = self.subject.declared_gaussians, self.subject.declared_count
        cells = self.subject.declared_cells
        with execute(
            path,
            names,
            plan.probes,
            self.subject.sandbox_limits,
            rows=rows.name if rows else "",
            count=count.name if count else "",
            cells=cells.name if cells else "",
            per_cell=cells.per_cell if cells else 0,
            maps_weights=maps_weights(self.subject),
            has_float16_weights=any(
                tensor.dtype == "float16" for tensor in self.subject.graph.initializers.values()
            ),
        ) as execution:
            self.runtime_seconds = execution.seconds
            self.environment["onnxruntime"] = execution.version
            seconds = [run.seconds for run in execution.runs]
            first = plan.values + sum(len(plan.trials[name]) for name in ("away", "sizes"))
            self.runs = {Level.VALUES: seconds[:first], Level.BEHAVIOUR: seconds[first:]}
            self.moments = tuple(
                plan.probes[index].label
                for index in plan.moments
                if index < len(execution.runs) and not execution.runs[index].missing_resource
            )
            probe_runs = ProbeRuns(self.subject, execution, plan)
            for rule in prerequisite_rules:
                if self.results.is_ready(rule):
                    self.results.check(rule, probe_runs)
                    self.results.settle([rule], items=len(execution.runs))
            if self.results.outcomes[MODEL_RUNS].status == "pass":
                self.progress("checking values")
                self._check_values(probe_runs)
                self.finished_level = Level.VALUES
                if level >= Level.BEHAVIOUR:
                    self._check_behaviour(probe_runs)
                    self.finished_level = Level.BEHAVIOUR
                self._check_backend_levels(probe_runs)

    def _require_runnable_level(self, prerequisite_rules: list[Rule]) -> bool:
        """Return whether the model may be run; otherwise skip the rules that need outputs."""
        runs = self.registry.rules.get(MODEL_RUNS)
        if runs is None:
            reason = f"because no rule {MODEL_RUNS} is installed"
        else:
            gate_rule = next(
                rule for rule in prerequisite_rules if rule.id in (MODEL_RUNS, *runs.needs)
            )
            is_gate_rule_ready = self.results.is_ready(
                gate_rule
            )  # its needs are static rules, which are settled
            reason = "" if is_gate_rule_ready else self.results.outcomes[gate_rule.id].reason
        for level in (Level.VALUES, Level.BEHAVIOUR):
            if level <= self.settings.level:
                message = f"the model was not run {reason}" if reason else ""
                self.levels.append(LevelOutcome(level=level, ran=not reason, reason=message))
        return not reason

    def _check_values(self, probe_runs: ProbeRuns) -> None:
        execution, plan = probe_runs.execution, probe_runs.plan
        cameras = isolated_views(probe_runs)
        output_rules = self.results.ready_rules(
            self._rules_of_scope("emission", max_level=Level.VALUES)
        )
        probe_outputs: list[ModelOutputs] = []
        visited_samples: set[int] = set()
        rows = 0
        # All-zero inputs come last: some rules skip them, but not if another probe gave the same
        # outputs.
        runs = sorted(execution.runs[: plan.values], key=lambda r: plan.probes[r.probe].zeros)
        for run in runs:
            if run.sample in visited_samples:
                continue  # identical outputs were checked before
            visited_samples.add(run.sample)
            probe = plan.probes[run.probe]
            outputs = execution.samples[run.sample].outputs
            emission = read_outputs(
                self.subject, probe.label, outputs, zeros=probe.zeros, cameras=cameras
            )
            output_rules = [
                rule for rule in output_rules if self.results.check(rule, emission, probe.label)
            ]
            probe_outputs.append(emission)
        self.results.settle(output_rules, items=len(visited_samples))
        # Rules of rows may need rules of whole outputs, such as the order of the fields.
        row_rules = self.results.ready_rules(self._rules_of_scope("rows", max_level=Level.VALUES))
        for emission in probe_outputs:
            if emission.zeros:
                continue  # a frame of zeroed matrices has to be finite, which GI009 checks
            for chunk in chunks(emission):
                rows += len(chunk)
                row_rules = [
                    rule
                    for rule in row_rules
                    if self.results.check(rule, chunk, emission.probe, chunk.start)
                ]
        if not rows:
            self.results.skip(row_rules, "no probe gave packed rows")
        self.results.settle(row_rules, items=rows)
        self._check_sample(probe_outputs)

    def _check_sample(self, probe_outputs: list[ModelOutputs]) -> None:
        """Check statistical rules on the first model run with enough visible Gaussians."""
        rules = in_dependency_order(self._rules_of_scope("sample", max_level=Level.VALUES))
        samples = (draw_sample(emission) for emission in probe_outputs if rules)
        sample = next((sample for sample in samples if sample is not None), None)
        for rule in rules:
            if not self.results.is_ready(rule):
                continue
            if sample is None:
                self.results.exclude([rule], f"no probe draws {MIN_DRAWN_ROWS} rows or more")
                continue
            self.results.check(rule, sample, sample.emission.probe)
            self.results.settle([rule], items=sample.count)

    def _check_behaviour(self, probe_runs: ProbeRuns) -> None:
        self.progress("comparing runs")
        behaviour: Behaviour = read_behaviour(probe_runs)
        for rule in in_dependency_order(self._rules_of_scope("runs", max_level=Level.BEHAVIOUR)):
            if self.results.is_ready(rule):
                rule_behaviour = behaviour.without_unfinished()
                self.results.check(rule, rule_behaviour)
                if rule.id == AT_MOMENTS:
                    self._check_moments(rule, probe_runs)
                if rule_behaviour.unfinished_probes and not self.results.has_failing_finding(rule):
                    self.results.skip(
                        [rule], self._unfinished_reason(rule_behaviour.unfinished_probes)
                    )
                self.results.settle([rule], items=len(probe_runs.execution.runs))

    def _check_moments(self, rule: Rule, probe_runs: ProbeRuns) -> None:
        """Check the rules of single runs at named moments; count for ``rule`` what breaks the first."""
        execution, plan = probe_runs.execution, probe_runs.plan
        stored_runs: dict[int, Run] = {}  # one for each distinct set of outputs
        for run in (execution.runs[index] for index in plan.moments):
            if run.sample >= 0 and execution.samples[run.sample].outputs:
                stored_runs.setdefault(run.sample, run)
        rules = [entry for entry in self.registry.rules.values() if entry.at_moments]
        for entry in in_dependency_order(rules):
            if self.results.outcomes[entry.id].status != "pass" or rule.id in self.results.outcomes:
                continue
            reporting_rule = replace(rule, check=_reported_check(entry))
            for run in stored_runs.values():
                label = plan.probes[run.probe].label
                for context, start in self._contexts_of_run(entry.scope, run, probe_runs):
                    self.results.check(reporting_rule, context, label, start)
            if self.results.has_failing_finding(rule):
                return

    def _contexts_of_run(
        self, scope: Scope, run: Run, probe_runs: ProbeRuns
    ) -> Iterator[tuple[ProbeRuns | ModelOutputs | Rows, int]]:
        """Yield what a rule of a scope checks in one run, and the row at which that begins."""
        probe = probe_runs.plan.probes[run.probe]
        if scope == "execution":
            plan = replace(probe_runs.plan, probes=(probe,), values=1, trials={})
            execution = replace(probe_runs.execution, runs=(replace(run, probe=0),))
            yield replace(probe_runs, execution=execution, plan=plan), 0
            return
        outputs = probe_runs.execution.samples[run.sample].outputs
        emission = read_outputs(self.subject, probe.label, outputs)
        if scope == "emission":
            yield emission, 0
        else:
            yield from ((chunk, chunk.start) for chunk in chunks(emission))

    def _unfinished_reason(self, probes: list[tuple[str, str]]) -> str:
        from gsgen.contract.probing.sandbox_worker import EXTRA_PROBE_TIME_SHARE

        count = f"{len(probes)} of its probes" if len(probes) > 1 else "one of its probes"
        label, missing_resource = probes[0]
        if missing_resource == "memory":
            reason = "the memory limit was reached (see --memory)"
        else:
            share = f"{EXTRA_PROBE_TIME_SHARE:.0%} of the {self.settings.limits.seconds:g} s of processor time"
            reason = f"{share} were used up (see --timeout)"
        return f"{count} did not run, {label!r} first: {reason}"

    def _check_backend_levels(self, probe_runs: ProbeRuns) -> None:
        """Evaluate the rules of the validation levels for which a backend is registered."""
        for level, scope in _BACKEND_SCOPES.items():
            backend = self.registry.backends.get(level)
            if backend is not None and level <= self.settings.level:
                self.progress(backend.activity)
                self._check_with_backend(
                    backend,
                    probe_runs,
                    in_dependency_order(self._rules_of_scope(scope, max_level=level)),
                )
                self.finished_level = level

    def _check_with_backend(
        self, backend: LevelBackend, probe_runs: ProbeRuns, rules: list[Rule]
    ) -> None:
        with ExitStack() as stack:
            try:
                with plugin_exits_as_errors():
                    context = stack.enter_context(backend.prepare(probe_runs))
            except LevelUnavailable as error:
                self.levels.append(
                    LevelOutcome(level=backend.level, ran=False, reason=error.reason)
                )
                self.results.skip(rules, error.reason)
                return
            except HostProcessFailed:
                raise
            except Exception:  # a faulty backend must not prevent the report
                self.levels.append(
                    LevelOutcome(level=backend.level, ran=False, reason="it crashed")
                )
                self.results.crash(rules)
                return
            self.levels.append(LevelOutcome(level=backend.level, ran=True))
            self.environment.update(context.environment)
            self.runtime_seconds += context.seconds
            for rule in rules:
                if rule.id in context.skipped:
                    self.results.skip([rule], context.skipped[rule.id])
                elif self.results.is_ready(rule):
                    self.results.check(rule, context.context)
                    self.results.settle([rule], items=context.items)

    def _leave_unfinished_levels(self, reason: str) -> None:
        """Mark every level above the finished one as not run, with its rules that have no outcome."""
        self.levels = [entry for entry in self.levels if entry.level <= self.finished_level]
        for level in Level:
            if self.finished_level < level <= self.settings.level:
                self.levels.append(LevelOutcome(level=level, ran=False, reason=reason))
                rules = [r for r in self.registry.rules.values() if r.level is level]
                self.results.skip([rule for rule in rules if rule.scope != "report"], reason)

    def _settle_remaining_levels(self) -> None:
        """Mark every validation rule and level that was not executed as skipped."""
        requested_level = self.settings.level
        settled_levels = {outcome.level for outcome in self.levels}
        for level, reason in _MISSING_BACKEND.items():
            if level <= requested_level and level not in settled_levels:
                known = level in self.registry.backends
                message = "the model did not run to the end on the CPU" if known else reason
                self.levels.append(LevelOutcome(level=level, ran=False, reason=message))
        for rule in in_dependency_order(self.registry.rules.values()):
            if rule.id in self.results.outcomes or rule.scope == "report":
                continue
            if rule.level > requested_level:
                self.results.skip([rule], f"level {rule.level.word} was not requested")
            elif self.results.is_ready(rule):
                self.results.skip([rule], f"level {rule.level.word} did not run")

    def _check_report(self) -> None:
        """Check the validation rules about findings of other rules, such as unused waivers."""
        statuses = {id: outcome.status for id, outcome in self.results.outcomes.items()}
        settings = self.settings
        review = Review(self._collect_findings(), statuses, settings.waivers, settings.today)
        for rule in self._rules_of_scope("report", max_level=settings.level):
            if self.results.is_ready(rule):
                self.results.check(rule, review)
                self.results.settle([rule], items=1)


def _reported_check(rule: Rule) -> Check:
    """Return a rule's check whose violations name the rule, for another rule to report."""

    def check(context: Any) -> Iterator[Violation]:
        for violation in rule.check(context):
            expected = f"{violation.expected} ({rule.id})"
            hint = violation.hint or rule.hint
            yield replace(violation, expected=expected, hint=hint, can_be_zeroed=False)

    return check
