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
    "with_known_values",
]

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final

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


_VALUE_WORDS: Final = {
    "--antialias": {"mip": "mip-splatting on true", "classic": "none off false"},
    "--color-space": {"linear": "linear-rgb", "srgb": "rgb gamma"},
    "--dtype": {"float16": "fp16 half f16", "float32": "fp32 single full f32"},
    "--encoding": {"ascii": "text", "binary_little_endian": "binary le"},
    "--mode": {
        "alpha": "mask opacity",
        "color": "rgb rgba image",
        "depth": "depths distance",
        "normal": "normals",
    },
    "--provider": {
        "cpu": "cpuexecutionprovider",
        "cuda": "cuda:0 nvidia cudaexecutionprovider",
        "webgpu": "gpu wgpu webgpuexecutionprovider",
    },
    "--rasteriser": {"quads": "quad hardware", "tiles": "tile compute"},
    "--size": {
        "1280x720": "hd 720p",
        "1920x1080": "1080p fullhd full-hd fhd",
        "3840x2160": "4k 2160p uhd",
    },
    "--up": {
        "+x": "x x-up", "+y": "y y-up", "+z": "z z-up", "-x": "x-down", "-y": "y-down",
        "-z": "z-down",
    },
}  # fmt: skip
"""Option → value → the words for it, separated by spaces."""


def with_known_values(arguments: Sequence[str]) -> list[str]:
    """Return the words of a command line with the values that are meant, such as +z for `--up z`."""
    known: list[str] = []
    for word in arguments:
        option, has_value, value = word.partition("=")
        before = known[-1] if known else ""
        if before in _VALUE_WORDS:
            known.append(_known_value(before, word))
        elif has_value and option in _VALUE_WORDS:
            known.append(f"{option}={_known_value(option, value)}")
        else:
            known.append(word)
    return known


def _known_value(option: str, typed: str) -> str:
    words = _VALUE_WORDS[option]
    if typed in words:
        return typed
    meant = [
        value for value, others in words.items() if typed.casefold() in (value, *others.split())
    ]
    return meant[0] if meant else typed


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
