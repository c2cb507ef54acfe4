"""The command line, from the typer apps behind it."""

from importlib.metadata import EntryPoint, entry_points
from typing import Any

import typer

from docs_parts.tables import code, table
from gsgen.cli.app import build
from gsgen.cli.commands import find_commands

_OWNER = "gsgen"


def _ours(group: str) -> list[EntryPoint]:
    found = [p for p in entry_points(group=group) if p.dist and p.dist.name == _OWNER]
    return sorted(found, key=lambda point: point.name)


def _find(*words: str) -> Any:
    """Return the click command behind ``gsgen WORDS``."""
    found: Any = typer.main.get_command(build(list(find_commands().values())))
    for word in words:
        found = found.commands[word]
    return found


def command(*words: str) -> str:
    """Return what a command takes: its arguments and options."""
    found = _find(*words)
    rows = [_row(parameter) for parameter in found.params if parameter.name != "help"]
    usage = f"```text\ngsgen {' '.join([*words, *_usage(found)])}\n```"
    if not rows:
        return usage
    return f"{usage}\n\n{table(('argument or option', 'takes', 'meaning'), rows)}"


def _usage(found: Any) -> list[str]:
    if hasattr(found, "commands"):
        return ["COMMAND", "…"]
    words = ["[OPTIONS]"]
    for parameter in found.params:
        if parameter.param_type_name == "argument":
            word = parameter.name.upper() + ("…" if parameter.nargs == -1 else "")
            words.append(word if parameter.required else f"[{word}]")
        elif parameter.required:
            words.append(f"{parameter.opts[0]} {parameter.name.upper()}")
    return words


def _row(parameter: Any) -> tuple[str, str, str]:
    is_argument = parameter.param_type_name == "argument"
    names = [parameter.name.upper()] if is_argument else _names(parameter)
    text = parameter.help or ""
    default = parameter.default
    # A default that the option's own text names stands in brackets there.
    shown = default is not None and default is not False and not parameter.required
    if shown and not callable(default) and "[" not in text:
        text += f" [{getattr(default, 'value', default)}]"
    if parameter.required:
        text += " Required."
    return code(names), _takes(parameter), text.strip() or "–"


def _names(parameter: Any) -> list[str]:
    return [*parameter.opts, *parameter.secondary_opts]


def _takes(parameter: Any) -> str:
    if getattr(parameter, "is_flag", False):
        return "–"
    choices = getattr(parameter.type, "choices", None)
    if choices:
        return code(str(getattr(choice, "value", choice)) for choice in choices)
    if parameter.metavar:
        return f"`{parameter.metavar}`"
    kind = parameter.type.name.partition(" ")[0]
    low, high = getattr(parameter.type, "min", None), getattr(parameter.type, "max", None)
    limits = f" ≥ {low:g}" if low is not None else ""
    limits += f" ≤ {high:g}" if high is not None else ""
    return f"{kind}{limits}{', repeatable' if parameter.multiple else ''}" if _many(
        parameter
    ) else f"{kind}{limits}"


def _many(parameter: Any) -> bool:
    return bool(getattr(parameter, "multiple", False))


def plugins() -> str:
    """Return one section for each method that ``gsgen export`` knows."""
    parts = []
    for point in _ours("gsgen.generators"):
        plugin = point.load()
        head = f"### gsgen export {point.name}\n\n{plugin.summary} {plugin.reads}"
        parts.append(f"{head}\n\n{command('export', point.name)}")
    return "\n\n".join(parts)


def plugin_table() -> str:
    """Return the methods that ``gsgen export`` knows, each with its page."""
    rows = []
    for point in _ours("gsgen.generators"):
        plugin = point.load()
        inputs = code(plugin.inputs) or "none"
        link = f"[{point.name}]({point.name.replace('_', '-')}.md)"
        rows.append((link, plugin.summary, plugin.reads, inputs))
    return table(("plugin", "what it exports", "what it reads", "inputs of the model"), rows)
