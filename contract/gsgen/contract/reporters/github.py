"""GitHub Actions report: workflow commands that GitHub shows as annotations."""

__all__ = ["to_github"]

from collections.abc import Sequence

from gsgen.contract._safe_text import without_commands
from gsgen.contract.reporters.summary import summary_line, verdict_line
from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Finding
from gsgen.contract.validation.report import Entry, Unreadable

_COMMAND_OF_SEVERITY = {
    Severity.ERROR: "error",
    Severity.WARNING: "warning",
    Severity.INFO: "notice",
}


def to_github(entries: Sequence[Entry]) -> str:
    """Return GitHub annotations for each model's result and each finding that affects it."""
    lines: list[str] = []
    for entry in entries:
        if isinstance(entry, Unreadable):
            lines.append(_command("error", entry.path, "unreadable", str(entry.error)))
            continue
        for outcome in entry.outcomes:
            if outcome.status == "crashed":
                title = f"{outcome.rule.id} crashed"
                lines.append(_command("error", entry.path, title, outcome.reason))
        for outcome in entry.unchecked:
            title = f"{outcome.rule.id} {outcome.rule.slug} is required"
            lines.append(
                _command("error", entry.path, title, f"{outcome.status}: {outcome.reason}")
            )
        for finding in entry.findings:
            if finding.counts:
                lines.append(_workflow_annotation(entry.path, finding))
        lines.append(without_commands(f"gsgen: {entry.path}: {verdict_line(entry)}"))
    return "\n".join(
        [*lines, without_commands(summary_line(entries))] if len(entries) > 1 else lines
    )


def _workflow_annotation(path: str, finding: Finding) -> str:
    command = _COMMAND_OF_SEVERITY[finding.severity]
    if finding.certainty == "possible" and command == "error":
        command = "warning"  # a possible finding does not fail the model
    text = f"{finding.where}: {finding.message}\nhint: {finding.hint}"
    return _command(command, path, f"{finding.rule} {finding.slug}", text)


def _command(command: str, path: str, title: str, text: str) -> str:
    return f"::{command} file={_escape_property(path)},title={_escape_property(title)}::{_escape_data(text)}"


def _escape_data(text: str) -> str:
    text = without_commands(text, kept_chars="\n")
    return text.replace("%", "%25").replace("\n", "%0A")


def _escape_property(text: str) -> str:
    escaped_text = without_commands(text).replace("%", "%25")
    return escaped_text.replace(":", "%3A").replace(",", "%2C")
