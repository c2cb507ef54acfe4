"""Baselines: earlier reports, whose findings no longer make a validation fail."""

__all__ = ["Baseline", "KnownFindings", "read_baseline"]

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path, PurePath
from typing import Any

from gsgen.contract._safe_text import read_utf8
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.validation.finding import Location
from gsgen.contract.validation.report import REPORT_SCHEMA_FILE, Report, ResolvedFinding

# Fingerprint → the finding of the earlier report.
KnownFindings = Mapping[str, ResolvedFinding]

_WRITE_HINT = "Write one with: gsgen validate MODEL --format json -o FILE"
_COMPARED_STATUSES = ("pass", "fail")


@dataclass(frozen=True, slots=True)
class Baseline:
    """Known findings of one or more models, which do not make a validation fail.

    Attributes:
        path: The report it was read from.
        known: Path of a model in the earlier report → its findings.
    """

    path: str
    known: Mapping[str, KnownFindings]

    def apply(self, report: Report) -> Report:
        """Mark the findings of a report that the baseline contains, and list the resolved ones.

        A finding is resolved only if its rule was checked this time.
        """
        known = self.known_findings(report.path)
        findings = tuple(
            replace(finding, known=not finding.waived and finding.fingerprint in known)
            for finding in report.findings
        )
        fingerprints = {finding.fingerprint for finding in findings}
        checked = {
            outcome.rule.id for outcome in report.outcomes if outcome.status in _COMPARED_STATUSES
        }
        resolved = tuple(
            finding
            for fingerprint, finding in known.items()
            if fingerprint not in fingerprints and finding.rule in checked
        )
        return replace(report, findings=findings, baseline=self.path, resolved=resolved)

    def known_findings(self, path: str) -> KnownFindings:
        """Return the baseline's findings for the model at ``path``.

        A baseline of one model applies to every path. Among several models, the path decides, then
        the file name: other machines keep the same models in other folders.
        """
        if len(self.known) == 1:
            return next(iter(self.known.values()))
        if path in self.known:
            return self.known[path]
        name = PurePath(path).name
        same_name = (findings for uri, findings in self.known.items() if PurePath(uri).name == name)
        return {key: finding for findings in same_name for key, finding in findings.items()}


def read_baseline(path: Path) -> Baseline:
    """Read the JSON report at ``path`` as a baseline.

    Raises:
        ConfigInvalid: The file cannot be read, or is not a gsgen report.
    """
    where = str(path)
    try:
        document = json.loads(read_utf8(path))
    except OSError as error:
        raise ConfigInvalid(
            f"the baseline cannot be read: {error.strerror}", where=where
        ) from error
    except (ValueError, RecursionError) as error:
        raise ConfigInvalid(
            f"the baseline is not JSON: {error}", where=where, hint=_WRITE_HINT
        ) from error
    _check_shape(document, where)
    known: dict[str, dict[str, ResolvedFinding]] = {}
    for report in document.get("reports", [document]):
        known_findings_by_fingerprint = {
            entry["fingerprint"]: _read_finding(entry) for entry in report.get("findings", ())
        }
        known.setdefault(report["subject"]["uri"], {}).update(known_findings_by_fingerprint)
    return Baseline(where, known)


def _read_finding(entry: Mapping[str, Any]) -> ResolvedFinding:
    where = Location(entry["where"]["subject"], entry["where"].get("field", ""))
    keys = ("rule", "slug", "fingerprint", "message")
    return ResolvedFinding(where=where, **{key: entry[key] for key in keys})


def _check_shape(document: Any, where: str) -> None:
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import best_match

    name = document.get("schema") if isinstance(document, dict) else None
    if name != "gsgen-report/1":
        actual = f"schema {name!r}" if isinstance(name, str) else "no schema"
        message = (
            f"the baseline is not a validation report: {actual}; expected schema 'gsgen-report/1'"
        )
        raise ConfigInvalid(message, where=where, hint=_WRITE_HINT)
    text = (
        resources.files("gsgen.contract").joinpath("schemas", REPORT_SCHEMA_FILE).read_text("utf-8")
    )
    error = best_match(Draft202012Validator(json.loads(text)).iter_errors(document))
    if error is not None:
        json_path = ".".join(str(part) for part in error.absolute_path)
        location = f"{where}, {json_path}" if json_path else where
        raise ConfigInvalid(
            f"the baseline is not a validation report: {error.message[:200]}",
            where=location,
            hint=_WRITE_HINT,
        )
