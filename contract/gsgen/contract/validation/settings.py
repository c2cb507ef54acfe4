"""Settings of a validation, read from ``gsgen.toml`` or ``pyproject.toml``.

Precedence, strongest first: command line, settings file, target, the rule's own values.
"""

__all__ = ["PYPROJECT", "Settings", "config_schema", "read_config"]

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

from gsgen.contract._safe_text import read_utf8
from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.fields.json_schema import SCHEMA_DIALECT, schema_of
from gsgen.contract.spec.manifest import Tolerances
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import Target, known_targets, load_target
from gsgen.contract.spec.units import MEBIBYTE
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.contract.validation.waivers import Waiver

PYPROJECT = "pyproject.toml"

DEFAULT_LEVEL = Level.BEHAVIOUR


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """All settings of a validation: target, level, severities, limits, waivers.

    Attributes:
        level: The highest level to run.
        target: The consumer to validate for.
        fail_on: The lowest severity that makes the verdict ``invalid``.
        ignore: Rules whose findings are reported but do not count.
        severities: Rule id → severity, in place of those of target and rule.
        limits: Time and memory limits for running the model.
        strict: A missing manifest is an error for every target.
        seed: Seed of the probe set.
        source: The file that the settings were read from, for the report.
        tolerances: Field → largest difference of executions, in place of the manifest's.
        only: Rules to check, with those that they need; empty for all.
        required: Rules that must have been checked for the model to pass the gate.
        timings: Reports hold times, so that two of them are not equal.
        docs_url: Root of the published documentation, for links in reports.
        waivers: Accepted faults, with reasons.
        today: The day on which waivers are evaluated.
    """

    level: Level = DEFAULT_LEVEL
    target: Target = field(default_factory=lambda: load_target("core"))
    fail_on: Severity = Severity.ERROR
    ignore: frozenset[str] = frozenset()
    severities: Mapping[str, Severity] = field(default_factory=dict)
    limits: Limits = field(default_factory=Limits)
    strict: bool = False
    seed: int = 0
    source: str = "defaults"
    tolerances: Mapping[str, float] = field(default_factory=dict)
    only: frozenset[str] = frozenset()
    required: frozenset[str] = frozenset()
    timings: bool = False
    docs_url: str = ""
    waivers: tuple[Waiver, ...] = ()
    today: date = field(default_factory=date.today)

    def __post_init__(self) -> None:
        """Take words for level, target and severities; raise for values of other types."""
        words: dict[str, tuple[type, Callable[[str], object]]] = {
            "level": (Level, lambda word: Level.parse(word, "level")),
            "target": (Target, lambda word: load_target(word, "target")),
            "fail_on": (Severity, lambda word: Severity.parse(word, "fail_on")),
            "limits": (Limits, lambda word: word),
        }
        for name, (kind, parse) in words.items():
            value = getattr(self, name)
            if isinstance(value, str):
                value = parse(value)
                object.__setattr__(self, name, value)
            if not isinstance(value, kind):
                message = f"is {value!r}, expected a word or a {kind.__name__}"
                raise ConfigInvalid(message, where=name)

    def severity_of(self, rule: Rule) -> Severity:
        """Return a rule's severity: from the validation settings, or else from its declaration."""
        if rule.id in self.severities:
            return self.severities[rule.id]
        if self.strict and rule.id == "GM001":
            return Severity.ERROR
        return self.target.severities.get(rule.id, rule.severity)

    def for_model(self, path: Path) -> "Settings":
        """Return the validation settings with only the waivers for the model at ``path``."""
        return replace(
            self, waivers=tuple(waiver for waiver in self.waivers if waiver.matches(path))
        )


def read_config(path: Path, registry: Registry, base: Settings | None = None) -> Settings:
    """Read settings from ``gsgen.toml`` or ``pyproject.toml``; ``base`` supplies missing settings.

    Raises:
        ConfigInvalid: The file is not TOML, or holds an invalid value. For unknown keys, rules,
            targets and levels, the hint names the nearest known one.
    """
    where = str(path)
    try:
        data = tomllib.loads(read_utf8(path))
    except OSError as error:
        raise ConfigInvalid(
            f"the settings file cannot be read: {error.strerror}", where=where
        ) from error
    except (tomllib.TOMLDecodeError, UnicodeError) as error:
        raise ConfigInvalid(f"the settings file is not TOML: {error}", where=where) from error
    if path.name == PYPROJECT:
        data, where = data.get("tool", {}).get("gsgen", {}), f"{where}, tool.gsgen"
    _dates_to_text(data)
    _check_shape(data, config_schema(registry), where)
    return _apply_config(base or Settings(), data, registry, where)


def _apply_config(base: Settings, data: dict[str, Any], registry: Registry, where: str) -> Settings:
    section = data.get("validate", {})
    limits = Limits(
        section.get("timeout", base.limits.seconds),
        section.get("memory_mib", base.limits.memory // MEBIBYTE) * MEBIBYTE,
    )
    severities = {
        registry.find(name, f"{where}, [severity]").id: Severity.parse(word, where)
        for name, word in data.get("severity", {}).items()
    }
    ignored_rules, only, required = (
        frozenset(registry.find(name, f"{where}, {key}").id for name in section.get(key, []))
        for key in ("ignore", "only", "require_rules")
    )
    level, target, fail_on = (section.get(key) for key in ("level", "target", "fail_on"))
    return replace(
        base,
        level=Level.parse(level, where) if level else base.level,
        target=load_target(target, where) if target else base.target,
        fail_on=Severity.parse(fail_on, where) if fail_on else base.fail_on,
        ignore=base.ignore | ignored_rules,
        severities={**base.severities, **severities},
        limits=limits,
        strict=section.get("strict", base.strict),
        seed=section.get("seed", base.seed),
        source=where,
        only=only or base.only,
        required=base.required | required,
        docs_url=section.get("docs_url", base.docs_url),
        tolerances={**base.tolerances, **data.get("tolerances", {})},
        waivers=base.waivers + _parse_waivers(data, registry, where),
    )


def _dates_to_text(data: dict[str, Any]) -> None:
    """Convert dates in parsed TOML to strings, as the JSON Schema requires."""
    waivers = data.get("waive", [])
    for entry in waivers if isinstance(waivers, list) else ():
        if isinstance(entry, dict) and type(entry.get("until")) is date:
            entry["until"] = entry["until"].isoformat()


def _parse_waivers(data: dict[str, Any], registry: Registry, where: str) -> tuple[Waiver, ...]:
    waivers = []
    for number, entry in enumerate(data.get("waive", [])):
        location = f"{where}, waive.{number}"
        try:
            until_date = date.fromisoformat(entry["until"]) if "until" in entry else None
        except ValueError as error:
            message = f"{entry['until']!r} is not a date: expected one like 2027-01-01"
            raise ConfigInvalid(message, where=f"{location}.until") from error
        rule_id = registry.find(entry["rule"], f"{location}.rule").id
        reason, subject = entry["reason"].strip(), entry.get("where", "")
        waivers.append(
            Waiver(
                rule=rule_id,
                reason=reason,
                where=subject,
                model=entry.get("model", ""),
                until=until_date,
            )
        )
    return tuple(waivers)


def config_schema(registry: Registry) -> dict[str, object]:
    """Return the JSON Schema of ``gsgen.toml``, with every installed validation rule by name."""
    severities = list(Severity.words())
    rules = registry.rules.values()
    names = [name for rule in rules for name in (rule.id, rule.slug)]
    described_rules = {
        name: {"enum": severities, "description": rule.statement}
        for rule in rules
        for name in (rule.id, rule.slug)
    }
    waiver = _table(_waiver_schema(names)) | {"required": ["rule", "reason"]}
    tables = {
        "validate": _table(_validate_schema(names, severities)),
        "tolerances": _table(schema_of(Tolerances, title="tolerances")["properties"]),
        "severity": {
            "type": "object",
            "properties": described_rules,
            "additionalProperties": {"enum": severities},  # such as a rule in lower case
        },
        "waive": {"type": "array", "items": waiver},
    }
    return {"$schema": SCHEMA_DIALECT, "title": "gsgen.toml"} | _table(tables)


def _table(properties: object) -> dict[str, object]:
    """Return the JSON Schema of a TOML table that has no keys other than ``properties``."""
    return {"type": "object", "properties": properties, "additionalProperties": False}


def _validate_schema(names: list[str], severities: list[str]) -> dict[str, object]:
    """Return the JSON Schemas of the keys of the ``[validate]`` table in ``gsgen.toml``."""
    return {
        "level": {"enum": list(Level.words()), "description": "The highest level to run."},
        "target": {
            "type": "string",
            "examples": sorted(known_targets()),
            "description": "The consumer to validate for, name or name@version.",
        },
        "fail_on": {"enum": severities, "description": "Lowest severity that fails."},
        "ignore": {
            "type": "array",
            "items": {"type": "string", "examples": names},
            "description": "Rules, by id or name, whose findings do not count.",
        },
        "only": {
            "type": "array",
            "items": {"type": "string", "examples": names},
            "description": "The only rules to check, by id or name, with those that they need.",
        },
        "require_rules": {
            "type": "array",
            "items": {"type": "string", "examples": names},
            "description": "Rules, by id or name, that must have been checked: else exit code 1.",
        },
        "docs_url": {
            "type": "string",
            "pattern": "^https?://",
            "description": "Root of the published documentation, for links in reports.",
        },
        "timeout": {
            "type": "number",
            "exclusiveMinimum": 0,
            "description": "Seconds for all runs of a model together.",
        },
        "memory_mib": {
            "type": "integer",
            "minimum": 64,
            "description": "Memory for running a model, in MiB.",
        },
        "strict": {
            "type": "boolean",
            "description": "A missing manifest is an error for every target.",
        },
        "seed": {"type": "integer", "minimum": 0, "description": "Seed of the probe set."},
    }


def _waiver_schema(names: list[str]) -> dict[str, object]:
    """Return the JSON Schemas of the keys of a ``[[waive]]`` table in ``gsgen.toml``."""
    return {
        "rule": {
            "type": "string",
            "examples": names,
            "description": "The rule, by id or name, whose findings are accepted.",
        },
        "reason": {
            "type": "string",
            "pattern": r"\S",
            "description": "Why they are accepted; every report shows it.",
        },
        "where": {
            "type": "string",
            "description": "The only location it covers, as reports write it: output gaussians.",
        },
        "model": {
            "type": "string",
            "description": "The only models it covers: a path or file name, * matches any text.",
        },
        "until": {
            "type": "string",
            "format": "date",
            "description": "The last day on which it is valid: 2027-01-01.",
        },
    }


def _check_shape(data: dict[str, Any], schema: dict[str, object], where: str) -> None:
    from jsonschema import Draft202012Validator

    for error in Draft202012Validator(schema).iter_errors(data):
        key_path = ".".join(str(part) for part in error.absolute_path)
        location = f"{where}, {key_path}" if key_path else where
        if error.validator == "additionalProperties":
            known = error.schema["properties"]
            unknown_key = next(key for key in error.instance if key not in known)
            if unknown_key in known.get("validate", {}).get("properties", {}):
                hint = "Put it under [validate]."
                raise UnknownName(f"unknown key {unknown_key!r}", where=location, hint=hint)
            raise UnknownName.among("key", unknown_key, known, location)
        raise ConfigInvalid(error.message, where=location)
