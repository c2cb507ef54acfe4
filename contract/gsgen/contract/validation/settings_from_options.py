"""Combines command-line options, ``gsgen.toml`` and defaults into settings."""

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
from gsgen.contract.validation.settings import Settings, read_config

_DEFAULT_CONFIG = Path("gsgen.toml")


def make_settings(
    registry: Registry,
    *,
    level: str | None = None,
    target: str | None = None,
    fail_on: str | None = None,
    ignore: Iterable[str] = (),
    severity: Iterable[str] = (),
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
        config: The settings file; by default ``gsgen.toml`` of the current folder, if it exists.
        timeout: Seconds for all runs of a model together.
        memory: Memory for running a model, in MiB.
        strict: A missing manifest is an error.
        seed: Seed of the probe set.
        prefix: Start of option names, for messages.

    Raises:
        ConfigInvalid: An option or the file holds an invalid value.
    """
    path = config or (_DEFAULT_CONFIG if _DEFAULT_CONFIG.is_file() else None)
    base = read_config(path, registry) if path is not None else Settings()
    names = [name for entry in ignore for name in entry.split(",") if name]
    ignored = {registry.find(name, f"{prefix}ignore").id for name in names}
    severities = _severities(registry, severity, f"{prefix}severity")
    return replace(
        base,
        level=Level.parse(level, f"{prefix}level") if level else base.level,
        target=load_target(target, f"{prefix}target") if target else base.target,
        fail_on=Severity.parse(fail_on, f"{prefix}fail-on") if fail_on else base.fail_on,
        ignore=base.ignore | ignored,
        severities={**base.severities, **severities},
        limits=_limits(base.limits, timeout, memory),
        strict=strict or base.strict,
        seed=base.seed if seed is None else seed,
    )


def _severities(registry: Registry, entries: Iterable[str], where: str) -> dict[str, Severity]:
    severities: dict[str, Severity] = {}
    for entry in entries:
        name, sign, word = entry.partition("=")
        if not sign:
            hint = f"Write it as {name}=error."
            raise ConfigInvalid(
                f"{entry!r} has no '=': expected RULE=SEVERITY", where=where, hint=hint
            )
        severities[registry.find(name, where).id] = Severity.parse(word, where)
    return severities


def _limits(base: Limits, timeout: float | None, memory: int | None) -> Limits:
    seconds = base.seconds if timeout is None else timeout
    return Limits(seconds, base.memory if memory is None else memory * MEBIBYTE)
