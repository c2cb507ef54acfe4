"""Builds every model of the set, judges it, and sums up in a table."""

__all__ = ["Measured", "Measurement", "measure", "summary", "table", "write_model"]

import json
import re
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx

from contract.adversarial.case import Draft, Fault, RightModel
from contract.adversarial.report_view import Judgement, judge

_BROKEN_PROMISE = "{}: claims {} for {}, which is not so: {}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """What the validator said of one model.

    Attributes:
        name: The model.
        group: Its family of mistakes; for a right model, the tool that made it.
        sort: ``decidable``, ``heuristic`` or ``right``.
        verdict: The verdict.
        first: The rule of the first finding; empty without one.
        first_text: What that finding says.
        cause_first: Whether the first finding names the cause.
        cause_named: Whether any finding does.
        errors: Rules of confirmed errors.
        warnings: Rules of warnings, possible ones included.
        broken_promises: What the model claims of other tools, and what is not so.
    """

    name: str
    group: str
    sort: str
    verdict: str
    first: str
    first_text: str
    cause_first: bool
    cause_named: bool
    errors: list[str]
    warnings: list[str]
    broken_promises: list[str]

    @property
    def refused(self) -> bool:
        """Whether the model is not accepted."""
        return self.verdict in ("invalid", "unreadable")


@dataclass(frozen=True, slots=True)
class Measurement:
    """What the validator said of every model."""

    models: tuple[Measured, ...]

    def of(self, sort: str) -> list[Measured]:
        """Return the models of a sort."""
        return [model for model in self.models if model.sort == sort]


def write_model(draft: Draft, folder: Path) -> Path:
    """Write a model, its manifest in it and its files beside it."""
    proto = onnx.ModelProto()
    proto.CopyFrom(draft.proto)
    if draft.manifest is not None:
        text = draft.manifest
        if not isinstance(text, str):
            text = json.dumps(text)
        proto.metadata_props.add(key="gsgen.manifest", value=text)
    for name, content in draft.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    path = folder / "model.onnx"
    path.write_bytes(proto.SerializeToString())
    return path


def measure(
    faults: Iterable[Fault],
    right_models: Iterable[RightModel],
    progress: Callable[[str], None] = lambda _: None,
) -> Measurement:
    """Build and judge all models."""
    measured = []
    for case in (*faults, *right_models):
        with tempfile.TemporaryDirectory() as folder:
            path = write_model(case.build(), Path(folder))
            level = case.level if isinstance(case, Fault) else "behaviour"
            promises = _broken_promises(case, path)
            measured.append(_sum_up(case, judge(path, case.target, level), promises))
            progress(_line(measured[-1]))
    return Measurement(tuple(measured))


def _sum_up(case: Fault | RightModel, judgement: Judgement, promises: list[str]) -> Measured:
    findings = judgement.findings
    cause = case.cause if isinstance(case, Fault) else ()
    names_cause = [any(re.search(c, f.text, re.I) for c in cause) for f in findings]
    if isinstance(case, Fault):
        group, sort = case.family, "decidable" if case.decidable else "heuristic"
    else:
        group, sort = case.tool, "right"
    return Measured(
        name=case.name,
        group=group,
        sort=sort,
        verdict=judgement.verdict,
        first=findings[0].rule if findings else "",
        first_text=findings[0].text if findings else "",
        cause_first=bool(names_cause) and names_cause[0],
        cause_named=any(names_cause),
        errors=[f.rule for f in findings if f.severity == "error" and f.certainty == "confirmed"],
        warnings=[
            f.rule
            for f in findings
            if f.severity == "warning" or (f.severity == "error" and f.certainty != "confirmed")
        ],
        broken_promises=promises,
    )


def _broken_promises(case: Fault | RightModel, path: Path) -> list[str]:
    """Compare what a model claims of onnx.checker and ONNX Runtime with what they say."""
    checks_by_name = {"checker": (_check, True), "loads": (_load, True)}
    if isinstance(case, Fault):
        checks_by_name = {"checker": (_check, case.checker), "loads": (_load, case.loads)}
    broken = []
    for name, (attempt, claimed_success) in checks_by_name.items():
        complaint = attempt(path)
        if (not complaint) is not claimed_success:
            broken.append(_BROKEN_PROMISE.format(case.name, claimed_success, name, complaint[:300]))
    return broken


def _check(path: Path) -> str:
    try:
        onnx.checker.check_model(str(path))
    except (onnx.checker.ValidationError, OSError) as error:
        return str(error)
    return ""


def _load(path: Path) -> str:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    options.intra_op_num_threads = 1
    try:
        onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # ONNX Runtime has a class of its own for each status
        return str(error) or type(error).__name__
    return ""


def summary(measurement: Measurement) -> dict[str, Any]:
    """Return the counts and shares that the table prints."""
    decidable, heuristic = measurement.of("decidable"), measurement.of("heuristic")
    right = measurement.of("right")
    refused_right = sum(model.refused and model.cause_first for model in decidable)
    return {
        "decidable": len(decidable),
        "decidable_refused": sum(model.refused for model in decidable),
        "decidable_right_cause_first": sum(model.cause_first for model in decidable),
        "decidable_refused_with_right_cause_first": refused_right,
        "heuristic": len(heuristic),
        "heuristic_named": sum(model.cause_named for model in heuristic),
        "heuristic_named_first": sum(model.cause_first for model in heuristic),
        "right": len(right),
        "false_errors": sum(model.refused or bool(model.errors) for model in right),
        "warnings_on_right": sum(len(model.warnings) for model in right),
        "crashes": sum(model.verdict == "internal-error" for model in measurement.models),
    }


def table(measurement: Measurement) -> str:
    """Return the results as lines of text, family by family and in total."""
    lines = [
        f"{'family':<22}{'sort':<11}{'models':>7}{'refused':>9}{'cause first':>13}{'named':>7}"
    ]
    groups: dict[tuple[str, str], list[Measured]] = {}
    for model in measurement.models:
        if model.sort != "right":
            groups.setdefault((model.group, model.sort), []).append(model)
    for (family, sort), models in groups.items():
        refused = sum(model.refused for model in models)
        first = sum(model.cause_first for model in models)
        named = sum(model.cause_named for model in models)
        lines.append(f"{family:<22}{sort:<11}{len(models):>7}{refused:>9}{first:>13}{named:>7}")
    counts = summary(measurement)
    share = _share(counts)
    return "\n".join([*lines, "", *share])


def _share(counts: dict[str, Any]) -> list[str]:
    def of(key: str, whole: str) -> str:
        total = counts[whole]
        return f"{counts[key]} of {total} ({counts[key] / max(total, 1):.1%})"

    right = counts["right"]
    per_model = counts["warnings_on_right"] / max(right, 1)
    return [
        f"decidable refused                       {of('decidable_refused', 'decidable')}",
        "decidable refused, right cause first    "
        + of("decidable_refused_with_right_cause_first", "decidable"),
        f"heuristic named in any finding          {of('heuristic_named', 'heuristic')}",
        f"heuristic named in the first finding    {of('heuristic_named_first', 'heuristic')}",
        f"right models with a false error         {of('false_errors', 'right')}",
        f"warnings on right models                {counts['warnings_on_right']}"
        f" ({per_model:.2f} a model)",
        f"crashes                                 {counts['crashes']}",
    ]


def _line(model: Measured) -> str:
    if model.sort == "right":
        fine = not model.refused and not model.warnings
    else:
        fine = model.cause_first and (model.refused or model.sort == "heuristic")
    status_mark = "ok  " if fine else "MISS"
    reported_rules = ", ".join([*model.errors, *model.warnings]) or "no finding"
    return f"{status_mark} {model.sort:<10}{model.name:<54}{model.verdict:<10}{reported_rules}"
