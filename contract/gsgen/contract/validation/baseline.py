"""Baselines: an earlier report, whose findings are known and do not fail a model again."""

__all__ = ["Baseline", "KnownFindings", "read_baseline"]

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path, PurePath
from typing import Any

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.validation.finding import Location
from gsgen.contract.validation.report import Gone, Report

# Fingerprint → what was found.
KnownFindings = Mapping[str, Gone]

_MEND = "Make one with: gsgen validate MODEL --format json -o FILE"
_JUDGED = ("pass", "fail")
_SCHEMA = "report-1.schema.json"


@dataclass(frozen=True, slots=True)
class Baseline:
    """What is known of some models.

    Attributes:
        path: The report it was read from.
        known: A model, as it was named → its findings.
    """

    path: str
    known: Mapping[str, KnownFindings]

    def applied(self, report: Report) -> Report:
        """Return ``report`` with the findings that are known marked so, and those that are gone.

        What belongs to a rule that was not judged this time may be there still: it is not gone.
        """
        known = self.of(report.path)
        findings = tuple(
            replace(one, known=not one.waived and one.fingerprint in known)
            for one in report.findings
        )
        found = {one.fingerprint for one in findings}
        judged = {one.rule.id for one in report.outcomes if one.status in _JUDGED}
        gone = tuple(
            one
            for fingerprint, one in known.items()
            if fingerprint not in found and one.rule in judged
        )
        return replace(report, findings=findings, baseline=self.path, gone=gone)

    def of(self, path: str) -> KnownFindings:
        """Return what is known of the model at ``path``.

        A baseline of one model holds for any, whatever it is called now. Among several the path
        decides, or else the file's name: machines keep the same models in other folders.
        """
        if len(self.known) == 1:
            return next(iter(self.known.values()))
        if path in self.known:
            return self.known[path]
        name = PurePath(path).name
        named = (found for uri, found in self.known.items() if PurePath(uri).name == name)
        return {key: one for found in named for key, one in found.items()}


def read_baseline(path: Path) -> Baseline:
    """Read the JSON report at ``path`` as a baseline.

    Raises:
        ConfigInvalid: It cannot be read, or is no such report.
    """
    where = str(path)
    try:
        document = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise ConfigInvalid(f"cannot be read: {error.strerror}", where=where) from error
    except (ValueError, RecursionError) as error:
        raise ConfigInvalid(f"is not JSON: {error}", where=where, hint=_MEND) from error
    _check_shape(document, where)
    known: dict[str, dict[str, Gone]] = {}
    for one in document.get("reports", [document]):
        listed = {entry["fingerprint"]: _read(entry) for entry in one.get("findings", ())}
        known.setdefault(one["subject"]["uri"], {}).update(listed)
    return Baseline(where, known)


def _read(entry: Mapping[str, Any]) -> Gone:
    where = Location(entry["where"]["subject"], entry["where"].get("field", ""))
    names = (entry["rule"], entry["slug"], entry["fingerprint"])
    return Gone(*names, where, entry["message"])


def _check_shape(document: Any, where: str) -> None:
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import best_match

    name = document.get("schema") if isinstance(document, dict) else None
    if name != "gsgen-report/1":
        actual = f"schema {name!r}" if isinstance(name, str) else "no schema"
        what = f"is not a report: {actual}; wanted 'gsgen-report/1'"
        raise ConfigInvalid(what, where=where, hint=_MEND)
    text = resources.files("gsgen.contract").joinpath("schemas", _SCHEMA).read_text("utf-8")
    error = best_match(Draft202012Validator(json.loads(text)).iter_errors(document))
    if error is not None:
        place = ".".join(str(part) for part in error.absolute_path)
        at = f"{where}, {place}" if place else where
        raise ConfigInvalid(f"is not a report: {error.message[:200]}", where=at, hint=_MEND)
