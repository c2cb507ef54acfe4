"""`gsgen plugins`: list the methods that `gsgen export` can read."""

__all__ = ["plugins"]

from typing import Annotated, Any

import typer

from gsgen.contract._extensions import Command
from gsgen.contract.errors import UnknownName
from gsgen.sdk.commands.options import AsJson, echo_json
from gsgen.sdk.plugins.plugin import Plugin, find_plugins


def plugins(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAMES]…", help="List these plugins only.", show_default="all"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List the installed plugins: method, model inputs, and the files that each reads.

    Exits 2 if no plugin has a given name.
    """
    commands = find_plugins()
    for name in names or ():
        if name not in commands:
            raise UnknownName.among("plugin", name, commands)
    entries = [_facts(command) for name, command in commands.items() if not names or name in names]
    if as_json:
        echo_json(entries)
        return
    typer.echo("\n\n".join(_text(entry) for entry in entries))


def _facts(command: Command) -> dict[str, Any]:
    owner = command.point.dist
    facts: dict[str, Any] = {
        "name": command.name,
        "package": f"{owner.name} {owner.version}" if owner is not None else None,
        "usable": not command.missing,
        "missing": list(command.missing),
        "remedy": command.remedy if command.missing else None,
        "title": None,
        "summary": None,
        "reads": None,
        "inputs": [],
        "publication": None,
    }
    loaded = _loaded(command)
    if loaded is None:
        return facts
    if not isinstance(loaded, Plugin):  # another kind of command, or a broken plugin
        summary = (getattr(loaded, "__doc__", None) or "").strip().partition("\n")[0]
        return facts | {"summary": summary or None}
    return facts | {
        "title": loaded.title or None,
        "summary": loaded.headline,
        "reads": loaded.reads,
        "inputs": list(loaded.inputs),
        "publication": loaded.publication.describe() or None,
    }


def _loaded(command: Command) -> Any:
    """Return a plugin object without importing torch; None if the plugin's import fails."""
    if not command.missing:
        return command.load()
    try:
        return command.point.load()
    except ImportError:  # the missing package is needed for the import
        return None


def _text(facts: dict[str, Any]) -> str:
    lines = [f"{facts['name']}  ({facts['package'] or 'unknown package'})"]
    if not facts["usable"]:
        lines.append(f"  lacks {', '.join(facts['missing'])}: {facts['remedy']}")
    lines += [f"  {facts[key]}" for key in ("summary", "reads") if facts[key]]
    if facts["reads"]:
        lines.append(f"  Inputs of the model: {', '.join(facts['inputs']) or 'none'}.")
    if facts["publication"]:
        lines.append(f"  Published: {facts['publication']}.")
    return "\n".join(lines)
