"""Combines command-line options, ``gsgen.toml`` and defaults into validation settings."""

__all__ = ["make_settings"]

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.limits import Limits
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.spec.targets import load_target
from gsgen.contract.spec.units import MEBIBYTE
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import PYPROJECT, Settings, read_config

_DEFAULT_CONFIG = Path("gsgen.toml")


def make_settings(
    registry: Registry,
    *,
    level: str | None = None,
    target: str | None = None,
    fail_on: str | None = None,
    ignore: Iterable[str] = (),
    severity: Iterable[str] = (),
    only: Iterable[str] = (),
    require: Iterable[str] = (),
    timings: bool = False,
    config: Path | None = None,
    timeout: float | None = None,
    memory: int | None = None,
    strict: bool = False,
    seed: int | None = None,
    prefix: str = "--",
) -> Settings:
    """Return validation settings: options override ``gsgen.toml``, which overrides defaults.

    Args:
        registry: The known rules.
        level: The highest level to run.
        target: The consumer, as ``name`` or ``name@version``.
        fail_on: The lowest severity that fails.
        ignore: Rules by id or name; an entry may join several by commas.
        severity: Entries such as ``GV004=error``.
        only: The only rules to check, by id or name.
        require: Rules that must have been checked, by id or name.
        timings: Reports hold times.
        config: The settings file; by default ``gsgen.toml`` of the current folder, if it exists,
            else ``pyproject.toml`` if that has a table ``[tool.gsgen]``.
        timeout: Seconds for all runs of a model together.
        memory: Memory for running a model, in MiB.
        strict: A missing manifest is an error for every target.
        seed: Seed of the probe set.
        prefix: Start of option names, for messages.

    Raises:
        ConfigInvalid: An option or the file holds an invalid value.
    """
    path = config or _default_config()
    base = read_config(path, registry) if path is not None else Settings()
    ignored_ids = _rule_ids(registry, ignore, f"{prefix}ignore")
    selected_ids = _rule_ids(registry, only, f"{prefix}only") or base.only
    required = base.required | _rule_ids(registry, require, f"{prefix}require-rules")
    if selected_ids and (
        unchecked_ids := required - registry.with_needs(selected_ids).rules.keys()
    ):
        message = (
            f"{', '.join(sorted(unchecked_ids))} is required, but not among the rules to check"
        )
        raise ConfigInvalid(message, where=f"{prefix}only", hint="Add it there.")
    severities = _severity_overrides(registry, severity, f"{prefix}severity")
    return replace(
        base,
        level=Level.parse(level, f"{prefix}level") if level else base.level,
        target=load_target(target, f"{prefix}target") if target else base.target,
        fail_on=Severity.parse(fail_on, f"{prefix}fail-on") if fail_on else base.fail_on,
        ignore=base.ignore | ignored_ids,
        severities={**base.severities, **severities},
        only=selected_ids,
        required=required,
        timings=timings or base.timings,
        limits=_limits(base.limits, timeout, memory),
        strict=strict or base.strict,
        seed=base.seed if seed is None else seed,
    )


def _default_config() -> Path | None:
    if _DEFAULT_CONFIG.is_file():
        return _DEFAULT_CONFIG
    project_file = Path(PYPROJECT)
    has_gsgen_table = project_file.is_file() and b"tool.gsgen" in project_file.read_bytes()
    return project_file if has_gsgen_table else None


def _rule_ids(registry: Registry, entries: Iterable[str], where: str) -> frozenset[str]:
    names = [name for entry in entries for name in entry.split(",") if name]
    return frozenset(registry.find(name, where).id for name in names)


def _severity_overrides(
    registry: Registry, entries: Iterable[str], where: str
) -> dict[str, Severity]:
    severities: dict[str, Severity] = {}
    for entry in entries:
        name, sign, word = entry.partition("=")
        if not sign:
            rule, separator, severity = name.partition(":")
            hint = f"Write it as {rule}={severity if separator else 'error'}."
            raise ConfigInvalid(
                f"{entry!r} has no '=': expected RULE=SEVERITY", where=where, hint=hint
            )
        severities[registry.find(name, where).id] = Severity.parse(word, where)
    return severities


def _limits(base: Limits, timeout: float | None, memory: int | None) -> Limits:
    seconds = base.seconds if timeout is None else timeout
    return Limits(seconds, base.memory if memory is None else memory * MEBIBYTE)
