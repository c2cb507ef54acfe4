"""Baselines: an earlier report, whose findings are known and do not fail a model again."""

__all__ = ["Baseline", "read_baseline"]

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path, PurePath
from typing import Any

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.report import Report

_MEND = "Make one with: gsgen validate MODEL --format json -o FILE"
_SCHEMA = "report-1.schema.json"


@dataclass(frozen=True, slots=True)
class Baseline:
    """What is known of some models.

    Attributes:
        path: The report it was read from.
        known: A model, as it was named → fingerprints of its findings.
    """

    path: str
    known: Mapping[str, frozenset[str]]

    def applied(self, report: Report) -> Report:
        """Return ``report`` with the findings that are known marked so."""
        known = self.of(report.path)
        findings = tuple(
            replace(one, known=not one.waived and one.fingerprint in known)
            for one in report.findings
        )
        return replace(report, findings=findings, baseline=self.path)

    def of(self, path: str) -> frozenset[str]:
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
        return frozenset().union(*named)


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
        raise ConfigInvalid(f"is not JSON: {error}", where=where, mend=_MEND) from error
    _check_shape(document, where)
    known: dict[str, frozenset[str]] = {}
    for one in document.get("reports", [document]):
        found = frozenset(finding["fingerprint"] for finding in one.get("findings", ()))
        uri = one["subject"]["uri"]
        known[uri] = known.get(uri, frozenset()) | found
    return Baseline(where, known)


def _check_shape(document: Any, where: str) -> None:
    from jsonschema import Draft202012Validator
    from jsonschema.exceptions import best_match

    name = document.get("schema") if isinstance(document, dict) else None
    if name != "gsgen-report/1":
        saw = f"schema {name!r}" if isinstance(name, str) else "no schema"
        what = f"is not a report: {saw}; wanted 'gsgen-report/1'"
        raise ConfigInvalid(what, where=where, mend=_MEND)
    text = resources.files("gsgen.contract").joinpath("schemas", _SCHEMA).read_text("utf-8")
    error = best_match(Draft202012Validator(json.loads(text)).iter_errors(document))
    if error is not None:
        place = ".".join(str(part) for part in error.absolute_path)
        at = f"{where}, {place}" if place else where
        raise ConfigInvalid(f"is not a report: {error.message[:200]}", where=at, mend=_MEND)
