"""The command `gsgen repro`, which reproduces one model's violation of one validation rule."""

__all__ = ["repro"]

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.options import Config, Memory, Seed, TargetName, Timeout, complete_rules
from gsgen.cli.output import echo, echo_error, echo_json
from gsgen.contract.errors import ExitCode
from gsgen.contract.spec.layout import FIELDS

if TYPE_CHECKING:
    from gsgen.conformance.reproduction import Reproduction

_SHOWN_COLOR_VALUES = 6


def repro(
    model: Annotated[Path, typer.Argument(help="The ONNX file.", show_default=False)],
    rule: Annotated[
        str,
        typer.Option(
            help="The rule, by id or name.", show_default=False, autocompletion=complete_rules
        ),
    ],
    probe: Annotated[
        str | None, typer.Option(help="The probe, by label or number. [default: all probes]")
    ] = None,
    target: TargetName = None,
    config: Config = None,
    dump: Annotated[
        Path | None, typer.Option(help="Write inputs and outputs of the failing probe here (.npz).")
    ] = None,
    seed: Seed = None,
    timeout: Timeout = None,
    memory: Memory = None,
    *,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Check one rule of MODEL again, with one probe (set of test inputs) if that is enough.

    Exits 1 if the rule is broken, 0 if it holds, 2 if it cannot be checked, 3 if it crashed, 4 if
    MODEL is unreadable.
    """
    from gsgen.conformance.reproduction import reproduce
    from gsgen.contract.errors import ModelUnreadable
    from gsgen.contract.process.atomic_files import refuse_model
    from gsgen.contract.rules.catalogue import installed_rules
    from gsgen.contract.validation.settings_from_options import make_settings

    if dump:
        refuse_model(dump, [model])
    registry = installed_rules()
    checked_rule = registry.find(rule, "--rule")
    settings = make_settings(
        registry, target=target, config=config, timeout=timeout, memory=memory, seed=seed
    )
    try:
        reproduction = reproduce(model, checked_rule, settings, probe=probe, dump=dump)
    except ModelUnreadable as error:
        echo_error(error)
        raise typer.Exit(ExitCode.UNREADABLE) from error
    dump_file = dump if dump is not None and dump.is_file() else None
    if as_json:
        echo_json(_document(model, reproduction, dump_file))
    else:
        _print_reproduction(model, reproduction)
        if dump_file:
            echo(f"  inputs and outputs: {dump_file}")
    raise typer.Exit(ExitCode.FAILURE if reproduction.findings else ExitCode.SUCCESS)


def _document(
    model: Path, reproduction: "Reproduction", dump_file: Path | None
) -> dict[str, object]:
    from gsgen.contract.reporters.json_report import finding_to_dict

    def finite(values: tuple[float, ...]) -> list[float | None]:
        return [value if math.isfinite(value) else None for value in values]

    rule = reproduction.rule
    return {
        "path": str(model),
        "rule": rule.id,
        "reproduced": bool(reproduction.findings),
        "probes": list(reproduction.probes),
        "findings": [finding_to_dict(finding, rule) for finding in reproduction.findings],
        "rows": [
            {"row": row.number, "probe": row.probe}
            | dict(zip(FIELDS, finite(row.packed), strict=True))
            | {"color": finite(row.color)}
            for row in reproduction.rows
        ],
        "dump": str(dump_file) if dump_file else None,
    }


def _print_reproduction(model: Path, reproduction: "Reproduction") -> None:
    from gsgen.cli.output import show
    from gsgen.contract.reporters.text import Line, finding_lines

    where = (
        f"{model} at probe {', '.join(reproduction.probes)}" if reproduction.probes else str(model)
    )
    if not reproduction.findings:
        show([Line(f"does not reproduce: {reproduction.rule.id} holds for {where}", "bold green")])
        return
    show([Line(f"{where}:", "bold")])
    show(finding_lines(reproduction.findings))
    show([Line(text) for text in _reproduction_table(reproduction)])
    show([Line(f"reproduced: {reproduction.rule.id} is broken", "bold red")])


def _reproduction_table(reproduction: "Reproduction") -> list[str]:
    if not reproduction.rows:
        return []
    lines = [f"  rows at probe {reproduction.rows[0].probe}:"]
    lines.append("  " + "".join(f"{name:>13}" for name in ("row", *FIELDS)) + "  color")
    for row in reproduction.rows:
        numbers = "".join(f"{value:13.6g}" for value in row.packed)
        color = " ".join(f"{value:.4g}" for value in row.color[:_SHOWN_COLOR_VALUES])
        ellipsis = " …" if len(row.color) > _SHOWN_COLOR_VALUES else ""
        lines.append(f"  {row.number:13d}{numbers}  {color}{ellipsis}")
    return lines
