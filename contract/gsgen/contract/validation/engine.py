"""Judge a model: open it, check what its file says, run it, check what it emits."""

__all__ = ["Progress", "silent", "validate_with"]

import os
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from functools import cache
from importlib.metadata import version
from pathlib import Path

from gsgen.contract.model.inspected_model import inspect_model
from gsgen.contract.model.model_file import open_model
from gsgen.contract.probing.outputs import chunks, read_outputs
from gsgen.contract.probing.probe_plan import Plan, fetched_outputs, make_plan
from gsgen.contract.probing.run_comparison import Behaviour, ProbeRuns, read_behaviour
from gsgen.contract.probing.sandbox import Execution, execute
from gsgen.contract.probing.sandbox_worker import SHARE_FOR_EXTRAS
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.digest import digest
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.level_backend import LevelBackend, LevelUnavailable
from gsgen.contract.validation.outcomes import ResultCollector
from gsgen.contract.validation.report import LevelOutcome, Report
from gsgen.contract.validation.rule import Registry, Rule, Scope
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validation.tolerances import effective_tolerances
from gsgen.contract.validation.waivers import Review, waive

# Called with what is being done, for progress displays.
Progress = Callable[[str], None]

# The rule that holds when the model ran to the end; nothing can be said of values before.
_RUNS = "GV025"
_WHERE_FROM = {
    Level.LIVE: "no installed package checks it; it needs gsgen[live]",
    Level.RENDER: "no installed package checks it; it needs gsgen[runtime]",
}
# Levels that are run by what another package registers, and the scope of their rules.
_FURTHER: dict[Level, Scope] = {Level.LIVE: "live", Level.RENDER: "render"}


_version = cache(version)  # reads a file of text


def silent(_: str) -> None:
    """Show no progress."""


def validate_with(
    registry: Registry,
    path: str | os.PathLike[str],
    settings: Settings,
    *,
    progress: Progress = silent,
) -> Report:
    """Validate the model at ``path`` by the rules of ``registry``, and return the report.

    Args:
        registry: The rules and the backends of the levels.
        path: An ONNX file.
        settings: Level, target, limits and severities.
        progress: Called with a few words whenever a new stage begins.

    Raises:
        ModelUnreadable: The file is not an ONNX model.
    """
    return _Validation(Path(path), settings, registry, progress).report()


class _Validation:
    """One validation, stage by stage."""

    def __init__(
        self, path: Path, settings: Settings, registry: Registry, progress: Progress
    ) -> None:
        self.began = time.perf_counter()
        self.settings = settings = settings.for_model(path)
        self.progress = progress
        self.progress(f"reading {path.name}")
        self.registry = registry
        file = open_model(path)
        self.subject = inspect_model(
            file, settings.target, settings.limits, settings.tolerances
        )
        self.board = ResultCollector(self.registry, settings, self.subject.kind)
        self.levels = [LevelOutcome(Level.STATIC, ran=True)]
        self.probes: tuple[str, ...] = ()
        self.environment = {"onnx": _version("onnx")}
        self.runtime_seconds = 0.0

    def report(self) -> Report:
        """Run every stage that was asked for, and sum up."""
        self._judge_model()
        self._judge_runs()
        self._skip_the_rest()
        self._judge_report()
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
            findings=self._findings(),
            outcomes=tuple(self.board.outcomes[id] for id in self.registry.rules),
            levels=tuple(self.levels),
            probes=self.probes,
            environment=self.environment,
            settings=self.settings.source,
            seconds=time.perf_counter() - self.began,
            runtime_seconds=self.runtime_seconds,
            sha256=digest(subject.file.path, self.settings.level, subject.file.size),
            tolerances=effective_tolerances(subject),
        )

    def _findings(self) -> tuple[Finding, ...]:
        return waive(self.board.findings(), self.settings.waivers, self.settings.today)

    def _of_scope(self, *scopes: Scope, upto: Level) -> list[Rule]:
        rules = self.registry.rules.values()
        return [rule for rule in rules if rule.scope in scopes and rule.level <= upto]

    def _judge_model(self) -> None:
        for rule in _needs_first(self._of_scope("model", upto=Level.STATIC)):
            if self.board.is_ready(rule):
                self.board.judge(rule, self.subject)
                self.board.settle([rule], items=1)

    def _judge_runs(self) -> None:
        level = self.settings.level
        if level < Level.VALUES:
            return
        gates = _needs_first(self._of_scope("execution", upto=Level.VALUES))
        if not self._can_run(gates):
            return
        plan = make_plan(self.subject, level, self.settings.seed)
        self.probes = tuple(probe.label for probe in plan.probes[: plan.values])
        self.progress(f"running {len(plan.probes)} probes in ONNX Runtime")
        path, names = self.subject.file.path, fetched_outputs(self.subject)
        with execute(path, names, plan.probes, self.subject.granted) as execution:
            self.runtime_seconds = execution.seconds
            self.environment["onnxruntime"] = execution.version
            trial = ProbeRuns(self.subject, execution, plan)
            for rule in gates:
                if self.board.is_ready(rule):
                    self.board.judge(rule, trial)
                    self.board.settle([rule], items=len(execution.runs))
            if self.board.outcomes[_RUNS].status == "pass":
                self.progress("checking values")
                self._judge_values(execution, plan)
                if level >= Level.BEHAVIOUR:
                    self._judge_behaviour(trial)
                self._judge_further(trial)

    def _can_run(self, gates: list[Rule]) -> bool:
        """Say whether nothing that running depends on has failed; settle the gates if it has."""
        runs = self.registry.rules.get(_RUNS)
        if runs is None:
            reason = f"because no rule {_RUNS} is installed"
        else:
            gate = next(rule for rule in gates if rule.id in (_RUNS, *runs.needs))
            ready = self.board.is_ready(gate)  # all it needs is known before the model runs
            reason = "" if ready else self.board.outcomes[gate.id].reason
        for level in (Level.VALUES, Level.BEHAVIOUR):
            if level <= self.settings.level:
                why = f"the model was not run {reason}" if reason else ""
                self.levels.append(LevelOutcome(level, ran=not reason, reason=why))
        return not reason

    def _judge_values(self, execution: Execution, plan: Plan) -> None:
        whole = self.board.ready(self._of_scope("emission", upto=Level.VALUES))
        by_rows = self.board.ready(self._of_scope("rows", upto=Level.VALUES))
        seen: set[int] = set()
        rows = 0
        # All-zero inputs come last: if their outputs are those of another probe, they are judged
        # as that one, by all rules.
        runs = sorted(
            execution.runs[: plan.values], key=lambda r: plan.probes[r.probe].zeros
        )
        for run in runs:
            if run.sample in seen:
                continue  # the same bytes again
            seen.add(run.sample)
            probe = plan.probes[run.probe]
            outputs = execution.samples[run.sample].outputs
            emission = read_outputs(self.subject, probe.label, probe.zeros, outputs)
            whole = [
                rule for rule in whole if self.board.judge(rule, emission, probe.label)
            ]
            for chunk in chunks(emission):
                rows += len(chunk)
                by_rows = [
                    rule
                    for rule in by_rows
                    if self.board.judge(rule, chunk, probe.label, chunk.start)
                ]
        self.board.settle(whole, items=len(seen))
        if not rows:
            self.board.skip(by_rows, "no probe gave packed rows")
        self.board.settle(by_rows, items=rows)

    def _judge_behaviour(self, trial: ProbeRuns) -> None:
        self.progress("comparing runs")
        behaviour: Behaviour = read_behaviour(trial)
        for rule in _needs_first(self._of_scope("runs", upto=Level.BEHAVIOUR)):
            if self.board.is_ready(rule):
                seen = behaviour.for_a_rule()
                self.board.judge(rule, seen)
                if seen.unfinished_probes and not self.board.fails(rule):
                    self.board.skip([rule], self._out_of_time(seen.unfinished_probes))
                self.board.settle([rule], items=len(trial.execution.runs))

    def _out_of_time(self, probes: list[str]) -> str:
        words = f"{len(probes)} of its probes" if len(probes) > 1 else "one of its probes"
        share = (
            f"{SHARE_FOR_EXTRAS:.0%} of the {self.settings.limits.seconds:g} s were gone"
        )
        return f"{words} did not run, {probes[0]!r} first: {share} (see --timeout)"

    def _judge_further(self, trial: ProbeRuns) -> None:
        """Judge the levels that other packages run, as far as they can run here."""
        for level, scope in _FURTHER.items():
            runner = self.registry.runners.get(level)
            if runner is not None and level <= self.settings.level:
                self.progress(runner.activity)
                self._judge_with(
                    runner, trial, _needs_first(self._of_scope(scope, upto=level))
                )

    def _judge_with(
        self, runner: LevelBackend, trial: ProbeRuns, rules: list[Rule]
    ) -> None:
        with ExitStack() as stack:
            try:
                prepared = stack.enter_context(runner.prepare(trial))
            except LevelUnavailable as error:
                self.levels.append(
                    LevelOutcome(runner.level, ran=False, reason=error.reason)
                )
                self.board.skip(rules, error.reason)
                return
            except Exception:  # a runner's fault must not take the report down
                self.levels.append(
                    LevelOutcome(runner.level, ran=False, reason="it crashed")
                )
                self.board.crash(rules)
                return
            self.levels.append(LevelOutcome(runner.level, ran=True))
            self.environment.update(prepared.environment)
            self.runtime_seconds += prepared.seconds
            for rule in rules:
                if rule.id in prepared.unjudged:
                    self.board.skip([rule], prepared.unjudged[rule.id])
                elif self.board.is_ready(rule):
                    self.board.judge(rule, prepared.context)
                    self.board.settle([rule], items=prepared.items)

    def _skip_the_rest(self) -> None:
        """Account for every rule and level that was not reached."""
        asked = self.settings.level
        settled = {one.level for one in self.levels}
        for level, reason in _WHERE_FROM.items():
            if level <= asked and level not in settled:
                known = level in self.registry.runners
                why = "the model did not run to the end on the CPU" if known else reason
                self.levels.append(LevelOutcome(level, ran=False, reason=why))
        for rule in _needs_first(self.registry.rules.values()):
            if rule.id in self.board.outcomes or rule.scope == "report":
                continue
            if rule.level > asked:
                self.board.skip([rule], f"level {rule.level.word} was not asked for")
            elif self.board.is_ready(rule):
                self.board.skip([rule], f"level {rule.level.word} did not run")

    def _judge_report(self) -> None:
        """Judge what the other rules found: do all waivers waive something?"""
        statuses = {id: outcome.status for id, outcome in self.board.outcomes.items()}
        settings = self.settings
        review = Review(self._findings(), statuses, settings.waivers, settings.today)
        for rule in self._of_scope("report", upto=settings.level):
            if self.board.is_ready(rule):
                self.board.judge(rule, review)
                self.board.settle([rule], items=1)


def _needs_first(rules: Iterable[Rule]) -> list[Rule]:
    """Order rules so that each comes after those it needs."""
    pending = {rule.id: rule for rule in rules}
    ordered: list[Rule] = []

    def place(rule: Rule) -> None:
        if pending.pop(rule.id, None) is None:
            return
        for need in rule.needs:
            if need in pending:
                place(pending[need])
        ordered.append(rule)

    for rule in list(pending.values()):
        place(rule)
    return ordered
