"""How a validation is configured: options, ``gsgen.toml``, and what wins over what.

Precedence, strongest first: command line, configuration file, target, the rule's own.
"""

__all__ = ["Settings", "config_schema", "read_config"]

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import date
from pathlib import Path
from typing import Any

from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.json_schema import DIALECT, schema_of
from gsgen.contract.spec.manifest import Tolerances
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import Target, known_targets, load_target
from gsgen.contract.validation.rule import Registry, Rule
from gsgen.contract.validation.waivers import Waiver

DEFAULT_LEVEL = Level.BEHAVIOUR
MEBIBYTE = 1 << 20


@dataclass(frozen=True, slots=True)
class Settings:
    """Everything that steers a validation.

    Attributes:
        level: How far to go.
        target: The consumer to judge for.
        fail_on: The lowest severity that makes the verdict ``invalid``.
        ignore: Rules whose findings are reported but do not count.
        severities: Rule id → severity, over what target and rule say.
        limits: What running the model may use.
        strict: A missing manifest is an error.
        seed: Seed of the probe set.
        source: Where the settings came from, for the report.
        tolerances: Field → how far executions may differ, over what the manifest says.
        waivers: Faults that are accepted, and why.
        today: The day on which waivers are judged.
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
    waivers: tuple[Waiver, ...] = ()
    today: date = field(default_factory=date.today)

    def severity_of(self, rule: Rule) -> Severity:
        """Return the severity that holds for ``rule`` here."""
        if rule.id in self.severities:
            return self.severities[rule.id]
        if self.strict and rule.id == "GM001":
            return Severity.ERROR
        return self.target.severities.get(rule.id, rule.severity)

    def for_model(self, path: Path) -> "Settings":
        """Return the settings with only those waivers that speak of the model at ``path``."""
        return replace(
            self, waivers=tuple(one for one in self.waivers if one.matches(path))
        )


def read_config(path: Path, registry: Registry, base: Settings | None = None) -> Settings:
    """Read ``gsgen.toml`` on top of ``base``.

    Raises:
        ConfigInvalid: It is no TOML, or says something that cannot be meant; unknown keys,
            rules, targets and levels are errors that name the nearest known one.
    """
    where = str(path)
    try:
        data = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise ConfigInvalid(f"cannot be read: {error.strerror}", where=where) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigInvalid(f"is not TOML: {error}", where=where) from error
    _write_out_days(data)
    _check_shape(data, config_schema(registry), where)
    return _apply(base or Settings(), data, registry, where)


def _apply(
    base: Settings, data: dict[str, Any], registry: Registry, where: str
) -> Settings:
    section = data.get("validate", {})
    limits = Limits(
        section.get("timeout", base.limits.seconds),
        section.get("memory_mib", base.limits.memory // MEBIBYTE) * MEBIBYTE,
    )
    severities = {
        registry.find(name, f"{where}, [severity]").id: Severity.parse(word, where)
        for name, word in data.get("severity", {}).items()
    }
    ignored = {
        registry.find(name, f"{where}, ignore").id for name in section.get("ignore", [])
    }
    level, target, fail_on = (section.get(key) for key in ("level", "target", "fail_on"))
    return replace(
        base,
        level=Level.parse(level, where) if level else base.level,
        target=load_target(target, where) if target else base.target,
        fail_on=Severity.parse(fail_on, where) if fail_on else base.fail_on,
        ignore=base.ignore | ignored,
        severities={**base.severities, **severities},
        limits=limits,
        strict=section.get("strict", base.strict),
        seed=section.get("seed", base.seed),
        source=where,
        tolerances={**base.tolerances, **data.get("tolerances", {})},
        waivers=base.waivers + _waivers(data, registry, where),
    )


def _write_out_days(data: dict[str, Any]) -> None:
    """Write TOML's dates as text, which is what a JSON Schema knows them as."""
    waivers = data.get("waive", [])
    for entry in waivers if isinstance(waivers, list) else ():
        if isinstance(entry, dict) and type(entry.get("until")) is date:
            entry["until"] = entry["until"].isoformat()


def _waivers(data: dict[str, Any], registry: Registry, where: str) -> tuple[Waiver, ...]:
    made = []
    for number, entry in enumerate(data.get("waive", [])):
        place = f"{where}, waive.{number}"
        try:
            until = date.fromisoformat(entry["until"]) if "until" in entry else None
        except ValueError as error:
            what = f"{entry['until']!r} is no day; wanted one like 2027-01-01"
            raise ConfigInvalid(what, where=f"{place}.until") from error
        named = registry.find(entry["rule"], f"{place}.rule").id
        reason, at = entry["reason"].strip(), entry.get("where", "")
        made.append(Waiver(named, reason, at, entry.get("model", ""), until))
    return tuple(made)


def config_schema(registry: Registry) -> dict[str, object]:
    """Return the JSON Schema of ``gsgen.toml``, every installed rule by name."""
    severities = list(Severity.words())
    names = [name for rule in registry.rules.values() for name in (rule.id, rule.slug)]
    section: dict[str, object] = {
        "level": {"enum": list(Level.words()), "description": "How far to go."},
        "target": {
            "type": "string",
            "examples": sorted(known_targets()),
            "description": "The consumer to judge for, name or name@version.",
        },
        "fail_on": {"enum": severities, "description": "Lowest severity that fails."},
        "ignore": {
            "type": "array",
            "items": {"type": "string", "examples": names},
            "description": "Rules, by id or name, whose findings do not count.",
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
        "strict": {"type": "boolean", "description": "A missing manifest is an error."},
        "seed": {"type": "integer", "minimum": 0, "description": "Seed of the probe set."},
    }
    waiver: dict[str, object] = {
        "rule": {
            "type": "string",
            "examples": names,
            "description": "The rule, by id or name, whose findings are accepted.",
        },
        "reason": {
            "type": "string",
            "pattern": r"\S",
            "description": "Why they are accepted; it is shown in every report.",
        },
        "where": {
            "type": "string",
            "description": "The only place it speaks of, as reports write it: output gaussians.",
        },
        "model": {
            "type": "string",
            "description": "The only models it speaks of: a path or file name, * stands for any.",
        },
        "until": {
            "type": "string",
            "format": "date",
            "description": "The last day on which it holds: 2027-01-01.",
        },
    }
    rules = {
        name: {"enum": severities, "description": rule.statement}
        for rule in registry.rules.values()
        for name in (rule.id, rule.slug)
    }
    return {
        "$schema": DIALECT,
        "title": "gsgen.toml",
        "type": "object",
        "properties": {
            "validate": {
                "type": "object",
                "properties": section,
                "additionalProperties": False,
            },
            "tolerances": {
                "type": "object",
                "properties": schema_of(Tolerances, title="tolerances")["properties"],
                "additionalProperties": False,
            },
            "severity": {
                "type": "object",
                "properties": rules,
                "additionalProperties": {"enum": severities},  # a rule in lower case, say
            },
            "waive": {
                "type": "array",
                "items": {
                    "type": "object",
                    "properties": waiver,
                    "required": ["rule", "reason"],
                    "additionalProperties": False,
                },
            },
        },
        "additionalProperties": False,
    }


def _check_shape(data: dict[str, Any], schema: dict[str, object], where: str) -> None:
    from jsonschema import Draft202012Validator

    for error in Draft202012Validator(schema).iter_errors(data):
        place = ".".join(str(part) for part in error.absolute_path)
        at = f"{where}, {place}" if place else where
        if error.validator == "additionalProperties":
            known = error.schema["properties"]
            stranger = next(key for key in error.instance if key not in known)
            if stranger in known.get("validate", {}).get("properties", {}):
                hint = "Put it under [validate]."
                raise UnknownName(f"unknown key {stranger!r}", where=at, hint=hint)
            raise UnknownName.among("key", stranger, known, at)
        raise ConfigInvalid(error.message, where=at)
