"""The command `gsgen doctor`: checks the installation and names the commands that repair it."""

__all__ = ["doctor"]

from dataclasses import asdict
from importlib import import_module
from typing import TYPE_CHECKING, Annotated

import typer

from gsgen.cli.output import echo_json
from gsgen.contract.errors import ExitCode

if TYPE_CHECKING:
    from gsgen.contract.tools.doctor import Check

# Room → the module with its checks.
_PART_TITLES = {
    "contract": "gsgen.contract.tools.doctor",
    "sdk": "gsgen.sdk.doctor",
    "runtime": "gsgen.runtime.doctor",
}
_STATE_STYLES = {"ok": "green", "missing": "yellow", "broken": "bold red"}


def doctor(as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False) -> None:
    """Show versions, drivers and adapters, and how to install missing parts.

    Exits 1 if something that is installed does not work.
    """
    from gsgen.cli.output import show
    from gsgen.contract.reporters.text import Line

    checks_by_room = {room: _run_checks(room) for room in _PART_TITLES}
    has_broken = any(
        check.state == "broken" for checks in checks_by_room.values() for check in checks
    )
    code = ExitCode.FAILURE if has_broken else ExitCode.SUCCESS
    if as_json:
        document = {
            room: [asdict(check) for check in checks] for room, checks in checks_by_room.items()
        }
        echo_json(document)
        raise typer.Exit(code)
    for room, checks in checks_by_room.items():
        show([Line(room, "bold")])
        for check in checks:
            purpose = f"  ({check.purpose})" if check.purpose else ""
            text = f"  {check.state:<8}{check.name:<22}{check.detail}{purpose}"
            show([Line(text, _STATE_STYLES[check.state])])
            if check.remedy:
                show([Line(f"          hint: {check.remedy}")])
    raise typer.Exit(code)


def _run_checks(room: str) -> "list[Check]":
    """Return the checks of a room; an error in them is a check that failed."""
    from gsgen.contract.tools.doctor import Check

    try:
        return list(import_module(_PART_TITLES[room]).checks())
    except Exception as error:  # a check must not take the others down
        return [Check(name=room, state="broken", detail=f"{type(error).__name__}: {error}")]
