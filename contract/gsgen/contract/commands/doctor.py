"""`gsgen doctor`: what works here, what is missing, and the command that mends it."""

__all__ = ["doctor"]

import json
from dataclasses import asdict
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract._entry_points import registered

if TYPE_CHECKING:
    from gsgen.contract.tools.doctor import Check

_ORDER = ("contract", "sdk", "runtime")
_STYLE = {"ok": "green", "missing": "yellow", "broken": "bold red"}


def doctor(
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Show versions, drivers and adapters, and how to mend what is missing.

    Exits 1 if something that is installed does not work.
    """
    from gsgen.contract.commands.output import show
    from gsgen.contract.reporters.text import Line

    found = {point.name: _ask(point) for point in _rooms()}
    broken = any(check.state == "broken" for checks in found.values() for check in checks)
    if as_json:
        made = {room: [asdict(check) for check in checks] for room, checks in found.items()}
        typer.echo(json.dumps(made, indent=2))
        raise typer.Exit(int(broken))
    for room, checks in found.items():
        show([Line(room, "bold")])
        for check in checks:
            purpose = f"  ({check.purpose})" if check.purpose else ""
            text = f"  {check.state:<8}{check.name:<22}{check.detail}{purpose}"
            show([Line(text, _STYLE[check.state])])
            if check.remedy:
                show([Line(f"          hint: {check.remedy}")])
    raise typer.Exit(int(broken))


def _rooms() -> list[EntryPoint]:
    """Return what each room registered, ours first."""

    def rank(point: EntryPoint) -> tuple[int, str]:
        ours = point.name in _ORDER
        return (_ORDER.index(point.name) if ours else len(_ORDER), point.name)

    return sorted(registered("gsgen.doctor"), key=rank)


def _ask(point: EntryPoint) -> "list[Check]":
    from gsgen.contract.tools.doctor import Check

    try:
        return list(point.load()())
    except Exception as error:  # a check must not take the others down
        return [Check(point.name, "broken", f"{type(error).__name__}: {error}")]
