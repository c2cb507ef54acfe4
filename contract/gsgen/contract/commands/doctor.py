"""The command `gsgen doctor`: checks the installation and names the commands that repair it."""

__all__ = ["doctor"]

import json
from dataclasses import asdict
from importlib.metadata import EntryPoint
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.contract._entry_points import registered_entry_points
from gsgen.contract.errors import ExitCode

if TYPE_CHECKING:
    from gsgen.contract.tools.doctor import Check

_ORDER = ("contract", "sdk", "runtime")
_STYLE = {"ok": "green", "missing": "yellow", "broken": "bold red"}


def doctor(as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False) -> None:
    """Show versions, drivers and adapters, and how to install missing parts.

    Exits 1 if something that is installed does not work.
    """
    from gsgen.contract.commands.output import show
    from gsgen.contract.reporters.text import Line

    checks_by_room = {point.name: _ask(point) for point in _rooms()}
    broken = any(check.state == "broken" for checks in checks_by_room.values() for check in checks)
    code = ExitCode.FAILURE if broken else ExitCode.SUCCESS
    if as_json:
        document = {
            room: [asdict(check) for check in checks] for room, checks in checks_by_room.items()
        }
        typer.echo(json.dumps(document, indent=2))
        raise typer.Exit(code)
    for room, checks in checks_by_room.items():
        show([Line(room, "bold")])
        for check in checks:
            purpose = f"  ({check.purpose})" if check.purpose else ""
            text = f"  {check.state:<8}{check.name:<22}{check.detail}{purpose}"
            show([Line(text, _STYLE[check.state])])
            if check.remedy:
                show([Line(f"          hint: {check.remedy}")])
    raise typer.Exit(code)


def _rooms() -> list[EntryPoint]:
    """Return the installation checks that packages register; gsgen's own come first."""

    def rank(point: EntryPoint) -> tuple[int, str]:
        is_known = point.name in _ORDER
        return (_ORDER.index(point.name) if is_known else len(_ORDER), point.name)

    return sorted(registered_entry_points("gsgen.doctor"), key=rank)


def _ask(point: EntryPoint) -> "list[Check]":
    from gsgen.contract.tools.doctor import Check

    try:
        return list(point.load()())
    except Exception as error:  # a check must not take the others down
        return [Check(name=point.name, state="broken", detail=f"{type(error).__name__}: {error}")]
