"""Prints which of forty modules, written as authors write them, are exported and captured live.

``make modules`` runs it. It fails where fewer than 36 are exported with parity, fewer than 95 % of
these are captured, or a refusal does not name its line and a hint.
"""

import sys
import tempfile
from collections import Counter
from pathlib import Path

from gsgen.contract.errors import GsgenError
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.settings import Settings
from gsgen.sdk import ExportRejected, export
from support.models.authored import MODULES, REFUSED, Cloud, Refusal
from support.models.captured import CAPTURED

FEWEST_EXPORTED, FEWEST_CAPTURED = 36, 0.95
LIVE_RULES = frozenset(CAPTURED)


def outcome(module: type[Cloud], path: Path) -> str:
    """Export a module, and return ``captured``, ``exported`` or ``failed``, with the reason."""
    try:
        report = export(module(), path, settings=Settings(level=Level.LIVE)).report
    except ExportRejected as error:
        # Parity is compared before the rules run.
        broken = {finding.rule for finding in error.report.findings}
        return f"exported: {error}" if broken <= LIVE_RULES else f"failed: {error}"
    except GsgenError as error:
        return f"failed: {error}"
    statuses = {rule: report.outcome(rule).status for rule in CAPTURED}
    passed = statuses == dict.fromkeys(CAPTURED, "pass")
    return "captured" if passed else f"exported: {statuses}"


def refusal(entry: Refusal, path: Path) -> str:
    """Export a module that cannot be, and return ``refused`` if the error is the right one."""
    try:
        export(entry.module(), path)
    except GsgenError as error:
        has_line = not entry.has_line or "# guilty" in error.where
        return "refused" if has_line and entry.hint in error.hint else f"failed: {error}"
    return "failed: it was exported"


def main() -> int:
    """Print a line for each module and the shares, and return 1 if a bar is missed."""
    outcomes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "module.onnx"
        for entry in (*MODULES, *REFUSED):
            is_refusal = isinstance(entry, Refusal)
            text = refusal(entry, path) if is_refusal else outcome(entry, path)
            module = entry.module if is_refusal else entry
            sys.stdout.write(f"{module.__name__:<20} {text}\n")
            sys.stdout.flush()
            outcomes[text.partition(":")[0]] += 1
    exported = outcomes["captured"] + outcomes["exported"]
    share = outcomes["captured"] / max(exported, 1)
    sys.stdout.write(
        f"{exported} of {outcomes.total()} exported with parity, {outcomes['refused']} refused "
        f"with their line and a hint, {outcomes['failed']} failed; {share:.0%} of the exported "
        "captured live\n"
    )
    holds = exported >= FEWEST_EXPORTED and share >= FEWEST_CAPTURED and not outcomes["failed"]
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
