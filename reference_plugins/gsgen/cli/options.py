"""Command-line options that several gsgen commands share: name, default and help text."""

__all__ = [
    "OPTION_ORDER",
    "Config",
    "FailOn",
    "LevelName",
    "Memory",
    "PrintJsonOption",
    "Seed",
    "TargetName",
    "Timeout",
    "complete_levels",
    "complete_rules",
    "complete_severities",
    "complete_targets",
]

from pathlib import Path
from typing import Annotated

import typer

OPTION_ORDER = "gsgen.option_order"
"""Key of ``Context.meta`` with the names of the parameters in the order typed, with repetitions."""


def complete_rules(incomplete: str) -> list[str]:
    """Return the ids of all rules that begin as typed, for a shell's TAB."""
    from gsgen.contract.rules.catalogue import installed_rules

    return [name for name in installed_rules().rules if name.startswith(incomplete.upper())]


def complete_severities(incomplete: str) -> list[str]:
    """Return RULE=SEVERITY for all severities, or the rules, that begin as typed."""
    rule, sign, word = incomplete.partition("=")
    if not sign:
        return [f"{identifier}=" for identifier in complete_rules(rule)]
    return [f"{rule}={severity}" for severity in _complete_fail_on(word)]


def complete_levels(incomplete: str) -> list[str]:
    """Return the validation levels that begin as typed."""
    from gsgen.contract.spec.severity import Level

    return [word for word in Level.words() if word.startswith(incomplete)]


def _complete_fail_on(incomplete: str) -> list[str]:
    from gsgen.contract.spec.severity import Severity

    return [word for word in Severity.words() if word.startswith(incomplete)]


def complete_targets(incomplete: str) -> list[str]:
    """Return the target runtimes that begin as typed."""
    from gsgen.contract.spec.targets import known_targets

    return [name for name in known_targets() if name.startswith(incomplete)]


LevelName = Annotated[
    str | None,
    typer.Option(
        help="How far to go: static, values, behaviour, live or render.",
        show_default="behaviour",
        autocompletion=complete_levels,
    ),
]
TargetName = Annotated[
    str | None,
    typer.Option(
        help="Consumer to validate for: core, webgpu, visionary, gsgen.",
        show_default="core",
        autocompletion=complete_targets,
    ),
]
FailOn = Annotated[
    str | None,
    typer.Option(
        help="Lowest severity that fails: error, warning or info.",
        show_default="error",
        autocompletion=_complete_fail_on,
    ),
]
PrintJsonOption = Annotated[
    bool, typer.Option("--json", help="Print as JSON: the same as --format json.")
]
Config = Annotated[
    Path | None,
    typer.Option(
        help="Configuration file.", show_default="./gsgen.toml, or [tool.gsgen] of ./pyproject.toml"
    ),
]
Timeout = Annotated[
    float | None,
    typer.Option(
        help="Time limit for all runs of a model, in seconds.", show_default="120", min=0.1
    ),
]
Memory = Annotated[
    int | None,
    typer.Option(help="Memory limit for running a model, in MiB.", show_default="2048", min=64),
]
Seed = Annotated[int | None, typer.Option(help="Seed of the probe set.", min=0)]
