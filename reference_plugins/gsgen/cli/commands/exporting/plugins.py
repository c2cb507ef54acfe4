"""`gsgen plugins`: list the methods that `gsgen export` can read."""

__all__ = ["plugins"]

from typing import Annotated, Any

import typer

from gsgen.cli.model_options import PrintJsonOption
from gsgen.cli.output import echo, echo_json
from gsgen.contract._entry_points import Extension, ExtensionUnusable
from gsgen.contract.errors import UnknownName
from gsgen.sdk.plugins.plugin import Plugin, find_plugins, words_of_plugins


def plugins(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAMES]…", help="List these plugins only.", show_default="all"),
    ] = None,
    as_json: PrintJsonOption = False,
) -> None:
    """List the installed plugins: method, model inputs, and the files that each reads.

    Exits 2 if no plugin has a given name.
    """
    extensions = find_plugins()
    for name in names or ():
        if name not in extensions:
            listing = "`gsgen plugins` lists them."
            words = words_of_plugins()
            raise UnknownName.among("plugin", name, extensions, words=words, listing=listing)
    entries = [
        _plugin_facts(extension)
        for name, extension in extensions.items()
        if not names or name in names
    ]
    if as_json:
        echo_json(entries)
        return
    for number, entry in enumerate(entries):
        echo(*([""] if number else []), *_plugin_lines(entry))


def _plugin_facts(extension: Extension) -> dict[str, Any]:
    distribution = extension.point.dist
    facts: dict[str, Any] = {
        "name": extension.name,
        "package": f"{distribution.name} {distribution.version}"
        if distribution is not None
        else None,
        "usable": not extension.missing,
        "missing": list(extension.missing),
        "remedy": extension.install_hint if extension.missing else None,
        "title": None,
        "summary": None,
        "reads": None,
        "inputs": [],
        "publication": None,
    }
    try:
        loaded_plugin = extension.load()
    except ExtensionUnusable as error:
        return facts | {"summary": None if extension.missing else error.summary}
    if not isinstance(loaded_plugin, Plugin):  # another kind of command
        summary = (getattr(loaded_plugin, "__doc__", None) or "").strip().partition("\n")[0]
        return facts | {"summary": summary or None}
    return facts | {
        "title": loaded_plugin.title or None,
        "summary": loaded_plugin.headline,
        "reads": loaded_plugin.reads,
        "inputs": list(loaded_plugin.inputs),
        "publication": loaded_plugin.publication.describe() or None,
    }


def _plugin_lines(facts: dict[str, Any]) -> list[str]:
    lines = [f"{facts['name']}  ({facts['package'] or 'unknown package'})"]
    if not facts["usable"]:
        lines.append(f"  lacks {', '.join(facts['missing'])}: {facts['remedy']}")
    lines += [f"  {facts[key]}" for key in ("summary", "reads") if facts[key]]
    if facts["reads"]:
        lines.append(f"  Inputs of the model: {', '.join(facts['inputs']) or 'none'}.")
    if facts["publication"]:
        lines.append(f"  Published: {facts['publication']}.")
    return lines
