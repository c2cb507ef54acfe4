"""Judge one mutant, and say everything that a validator must never do."""

__all__ = ["MEMORY", "Verdict", "judge", "peak"]

import json
import resource
import subprocess
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from fuzz.case import Case
from gsgen.contract.errors import ModelUnreadable
from gsgen.contract.probing import sandbox
from gsgen.contract.process.limits import Limits
from gsgen.contract.reporters.json_report import to_json
from gsgen.contract.reporters.text import render_all
from gsgen.contract.spec.targets import load_target
from gsgen.contract.validation.report import Entry, Report, Unreadable
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate

MEMORY = 2 << 30
# What ONNX Runtime's process may take.
_SECONDS, _MEMORY = 5.0, 1 << 30
_RUNS = ("GV025", "GS004")  # what fails where ONNX Runtime's process did not end well
_REPORTERS = ("sarif", "junit", "markdown", "github")


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a mutant.

    Attributes:
        word: ``conforms``, ``invalid``, ``unreadable`` or ``internal-error``.
        ran: It got as far as ONNX Runtime.
        failures: What the validator did that it must never do.
    """

    word: str
    ran: bool
    failures: tuple[str, ...]


def judge(case: Case, path: Path, registry: Registry | None = None) -> Verdict:
    """Judge the mutant at ``path``, in this process or by the command line."""
    if case.command and registry is None:
        return _by_command(case, path)
    settings = Settings(
        level=case.level, target=load_target(case.target), limits=Limits(_SECONDS, _MEMORY)
    )
    ended: list[int | None] = []
    entry: Entry
    try:
        with _children(ended):
            entry = validate(path, settings, registry=registry)
    except ModelUnreadable as error:
        entry = Unreadable(str(path), error)
    except BaseException:
        return Verdict("raised", bool(ended), (traceback.format_exc(limit=-6),))
    word = entry.verdict if isinstance(entry, Report) else "unreadable"
    return Verdict(word, bool(ended), tuple(_failures(entry, ended)))


def _failures(entry: Entry, ended: list[int | None]) -> Iterator[str]:
    if isinstance(entry, Report):
        yield from _faults(entry, ended)
    elif not entry.error.message:
        yield "an error without words"
    try:
        json.loads(to_json([entry]), parse_constant=_refuse)
        for name in _REPORTERS:
            module = import_module(f"gsgen.contract.reporters.{name}")
            getattr(module, f"to_{name}")([entry]).encode()
        for line in render_all([entry], verbose=True, quiet=False):
            line.text.encode()
    except Exception:
        yield f"a reporter raised: {traceback.format_exc(limit=-4)}"


def _refuse(word: str) -> float:
    raise ValueError(f"{word} is no JSON")


def _faults(report: Report, ended: list[int | None]) -> Iterator[str]:
    for outcome in report.outcomes:
        if outcome.status == "crashed":
            yield f"{outcome.rule.id} crashed: {outcome.reason}"
        if outcome.status in ("skipped", "not-applicable") and not outcome.reason:
            yield f"{outcome.rule.id} is {outcome.status} for no reason"
    for level in report.levels:
        if not level.ran and (not level.reason or "crashed" in level.reason):
            yield f"level {level.level.word} did not run: {level.reason or 'no reason'}"
    if report.verdict == "internal-error" and not report.statuses["crashed"]:
        yield "an internal error that no rule had"
    known = {outcome.rule.id: outcome.status for outcome in report.outcomes}
    failed_statuses = [status for status in ended if status != 0]
    if failed_statuses and not any(known.get(rule) == "fail" for rule in _RUNS):
        yield f"ONNX Runtime's process ended with {failed_statuses}, and the report does not say so"


def _by_command(case: Case, path: Path) -> Verdict:
    """Judge as a user does."""
    words = [sys.executable, "-m", "gsgen.cli", "validate", str(path), "--level", case.level.word]
    words += ["--target", case.target, "--format", "json", "--timeout", str(_SECONDS)]
    completed = subprocess.run(words, capture_output=True, text=True, errors="replace", check=False)
    failures = []
    if completed.returncode not in (0, 1, 4):
        failures.append(f"exit code {completed.returncode}: {completed.stderr[-2000:]}")
    if "Traceback" in completed.stderr or "Traceback" in completed.stdout:
        failures.append(f"a traceback: {completed.stderr[-2000:]}")
    try:
        json.loads(completed.stdout, parse_constant=_refuse)
    except ValueError as error:
        failures.append(f"what was printed is no JSON: {error}: {completed.stdout[:300]}")
    word = {0: "conforms", 1: "invalid", 4: "unreadable"}.get(completed.returncode, "raised")
    return Verdict(word, '"onnxruntime"' in completed.stdout, tuple(failures))


@contextmanager
def _children(ended: list[int | None]) -> Iterator[None]:
    """Note how ONNX Runtime's processes end."""
    product = sandbox._run_child

    def noted(folder: Path, seconds: float, module: str) -> "sandbox._ProcessEnd":
        process_end = product(folder, seconds, module)
        ended.append(process_end.status)
        return process_end

    sandbox._run_child = noted
    try:
        yield
    finally:
        sandbox._run_child = product


def peak() -> int:
    """Return the largest size that this process or a child of it ever had, in bytes."""
    usage_kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return max(resource.getrusage(entry).ru_maxrss for entry in usage_kinds) * 1024
