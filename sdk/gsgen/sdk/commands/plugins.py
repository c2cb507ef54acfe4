"""`gsgen plugins`: list what `gsgen export` can read."""

__all__ = ["plugins"]

import json
from typing import Annotated, Any

import typer

from gsgen.contract._extensions import Command
from gsgen.contract.errors import UnknownName
from gsgen.sdk.plugins.plugin import Plugin, find_plugins


def plugins(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAMES]…", help="Only these.", show_default="all"),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """List the installed plugins: what each exports, its inputs, and the files it reads.

    Exits 2 if there is no plugin of a given name.
    """
    found = find_plugins()
    for name in names or ():
        if name not in found:
            raise UnknownName.among("plugin", name, found)
    listed = [_facts(one) for name, one in found.items() if not names or name in names]
    if as_json:
        typer.echo(json.dumps(listed, indent=2, ensure_ascii=False))
        return
    typer.echo("\n\n".join(_text(one) for one in listed))


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
    if not isinstance(loaded, Plugin):  # a command of another shape, or one that is broken
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
    """Return the plugin, even where it lacks something: importing one imports no torch."""
    if not command.missing:
        return command.load()
    try:
        return command.point.load()
    except ImportError:  # it needs what is missing to be imported at all
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
