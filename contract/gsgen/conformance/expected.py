"""Expected failures: validation rules that a model is known to break, each with a reason.

A rule that holds although its failure is expected fails too. A TOML file has a table for each::

    [[xfail]]
    rule = "opacity-range"   # or GV003
    model = "drift*.onnx"    # optional: a path or a pattern
    reason = "logits until release 2"
"""

__all__ = ["ExpectedFailure", "read_expected", "unmatched_entries"]

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path, PurePath
from typing import Any

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.validation.rule import Registry

_TABLE_NAME = "xfail"
_ENTRY_KEYS = ("rule", "model", "reason")


@dataclass(frozen=True, slots=True)
class ExpectedFailure:
    """A validation rule that a model is expected to break, with the reason.

    Attributes:
        rule: The rule's id.
        reason: The reason why the failure is accepted.
        model: The path or pattern of the models; empty for all models.
        source: The file of the entry.
    """

    rule: str
    reason: str
    model: str = ""
    source: str = "expected failures"

    def __str__(self) -> str:
        models = f" of {self.model}" if self.model else ""
        return f"{self.source}: {self.rule}{models} ({self.reason})"

    def matches(self, rule: str, path: PurePath) -> bool:
        """Return whether the expected failure names this contract rule of the model at ``path``."""
        names = (path.as_posix(), path.name)
        model_matches = not self.model or any(fnmatchcase(name, self.model) for name in names)
        return model_matches and rule == self.rule


def read_expected(path: Path, registry: Registry) -> tuple[ExpectedFailure, ...]:
    """Read a TOML file of expected failures: validation rules that models are known to break.

    Raises:
        ConfigInvalid: The file is not TOML, or an entry lacks a rule or a reason.
        UnknownName: A rule or a key does not exist; the hint names the nearest.
    """
    where = str(path)
    try:
        data = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise ConfigInvalid(
            f"the file of expected failures cannot be read: {error.strerror}", where=where
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigInvalid(
            f"the file of expected failures is not TOML: {error}", where=where
        ) from error
    _refuse_unknown_keys(data, (_TABLE_NAME,), where)
    tables = data.get(_TABLE_NAME, [])
    if not (isinstance(tables, list) and all(isinstance(entry, dict) for entry in tables)):
        raise ConfigInvalid(
            f"{_TABLE_NAME} is {tables!r}, expected tables [[{_TABLE_NAME}]]", where=where
        )
    return tuple(
        _entry(table, f"{where}, {_TABLE_NAME} {number}", where, registry)
        for number, table in enumerate(tables, start=1)
    )


def _entry(table: dict[str, Any], where: str, source: str, registry: Registry) -> ExpectedFailure:
    _refuse_unknown_keys(table, _ENTRY_KEYS, where)
    for key, value in table.items():
        if not (isinstance(value, str) and value.strip()):
            raise ConfigInvalid(
                f"key {key!r} is {value!r}, expected a non-empty string", where=where
            )
    for key in ("rule", "reason"):
        if key not in table:
            raise ConfigInvalid(f"the table [[{_TABLE_NAME}]] lacks the key {key!r}", where=where)
    rule = registry.find(table["rule"], where).id
    return ExpectedFailure(rule, table["reason"], table.get("model", ""), source)


def _refuse_unknown_keys(table: Mapping[str, Any], known_keys: tuple[str, ...], where: str) -> None:
    for key in table:
        if key not in known_keys:
            raise UnknownName.among("key", key, known_keys, where)


def unmatched_entries(
    entries: Iterable[ExpectedFailure], rules_by_model: Mapping[Path, Iterable[str]]
) -> list[ExpectedFailure]:
    """Return the expected failures that match no validation rule tested on any model."""
    pairs = [(rule, path) for path, rules in rules_by_model.items() for rule in rules]
    return [entry for entry in entries if not any(entry.matches(*pair) for pair in pairs)]
