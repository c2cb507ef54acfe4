"""How a test run is configured: the options that every front end has, as settings."""

__all__ = ["make_settings", "needed_by"]

from dataclasses import replace
from pathlib import Path

from gsgen.contract.config import Settings, read_config
from gsgen.contract.finding import Level, Severity
from gsgen.contract.installed import installed_rules
from gsgen.contract.rule import Registry, Rule
from gsgen.contract.targets import load_target

_DEFAULT_CONFIG = Path("gsgen.toml")


def make_settings(
    *,
    level: str | None = None,
    target: str | None = None,
    fail_on: str | None = None,
    config: Path | None = None,
) -> Settings:
    """Return settings from words; ``gsgen.toml`` of the current folder counts where it is.

    Raises:
        ConfigInvalid: A word or the file says something that cannot be meant.
    """
    base = Settings()
    path = config or (_DEFAULT_CONFIG if _DEFAULT_CONFIG.is_file() else None)
    if path is not None:
        base = read_config(path, installed_rules(), base)
    return replace(
        base,
        level=Level.parse(level, "level") if level else base.level,
        target=load_target(target, "target") if target else base.target,
        fail_on=Severity.parse(fail_on, "fail-on") if fail_on else base.fail_on,
    )


def needed_by(rule: Rule, registry: Registry) -> Registry:
    """Return ``rule`` with all that must hold before it can be judged, in catalogue order."""
    wanted: set[str] = set()
    queue = [rule.id, *(() if rule.level == Level.STATIC else (_RUNS,))]
    while queue:
        name = queue.pop()
        if name not in wanted and name in registry.rules:
            wanted.add(name)
            queue.extend(registry.rules[name].needs)
    return Registry.of(one for one in registry.rules.values() if one.id in wanted)


# Without this one, the engine runs no model.
_RUNS = "GV025"
