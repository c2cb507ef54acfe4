"""The command line, from the typer apps behind it."""

import inspect
from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_args

import typer

from docs_parts.tables import code, table
from gsgen.cli.command_group import click_command
from gsgen.cli.command_table import PANELS, Command, find_command
from gsgen.sdk.plugins.plugin import Publication

_OWNER = "gsgen"


def _ours(group: str) -> list[EntryPoint]:
    points = [p for p in entry_points(group=group) if p.dist and p.dist.name == _OWNER]
    return sorted(points, key=lambda point: point.name)


def _commands() -> list[Command]:
    commands = [entry for panel in PANELS.values() for entry in panel]
    return sorted(commands, key=lambda entry: entry.name)


def _find(*words: str) -> Any:
    """Return the click command behind ``gsgen WORDS``."""
    entry = find_command(words[0])
    assert entry is not None
    result: Any = click_command(entry)
    for word in words[1:]:
        result = result.get_command(typer.Context(result), word)
    return result


def command(*words: str) -> str:
    """Return the arguments and options of a command as Markdown."""
    described = _find(*words)
    rows = [_row(parameter) for parameter in described.params if _shown(parameter)]
    usage = f"```text\ngsgen {' '.join([*words, *_usage(described)])}\n```"
    if not rows:
        return usage
    return f"{usage}\n\n{table(('argument or option', 'takes', 'meaning'), rows)}"


def _shown(parameter: Any) -> bool:
    return parameter.name != "help" and not getattr(parameter, "hidden", False)


def _usage(described: Any) -> list[str]:
    if hasattr(described, "commands"):
        return ["COMMAND", "…"]
    words = ["[OPTIONS]"]
    for parameter in described.params:
        if parameter.param_type_name == "argument":
            word = parameter.name.upper() + ("…" if parameter.nargs == -1 else "")
            words.append(word if parameter.required else f"[{word}]")
        elif parameter.required:
            words.append(f"{parameter.opts[0]} {parameter.name.upper()}")
    return words


def _row(parameter: Any) -> tuple[str, str, str]:
    is_argument = parameter.param_type_name == "argument"
    names = [*parameter.opts, *parameter.secondary_opts]
    text = (parameter.help or "").replace("\\[", "[")  # escaped for rich
    default = _default(parameter)
    if default:
        text += f" [{default}]"
    if parameter.required:
        text += " Required."
    spellings = [parameter.name.upper()] if is_argument else names
    return code(spellings), _takes(parameter), text.strip() or "–"


def _default(parameter: Any) -> str:
    """Return an option's default for readers; empty without one."""
    if isinstance(parameter.show_default, str):
        return parameter.show_default
    default = parameter.default
    if parameter.required or default is None or default is False or callable(default):
        return ""
    return str(getattr(default, "value", default))


def _takes(parameter: Any) -> str:
    if getattr(parameter, "is_flag", False):
        return "–"
    value_name, choices, low, high = _values(parameter)
    if choices:
        value_name = code(str(getattr(choice, "value", choice)) for choice in choices)
    elif parameter.metavar:
        value_name = f"`{parameter.metavar}`"
    value_name += f" ≥ {low:g}" if low is not None else ""
    value_name += f" ≤ {high:g}" if high is not None else ""
    many = getattr(parameter, "multiple", False)
    return f"{value_name}, repeatable" if many else value_name


def _values(parameter: Any) -> tuple[str, Any, float | None, float | None]:
    """Return what a parameter takes: the word for it, the choices, the minimum and maximum."""
    words = {"str": "text", "int": "integer", "float": "number", "Path": "path"}
    kind = getattr(parameter, "type", None)
    if kind is not None:
        name = kind.name.partition(" ")[0]
        limits = getattr(kind, "min", None), getattr(kind, "max", None)
        return words.get(name, name), getattr(kind, "choices", None), *limits
    # Since typer 0.29 a parameter has its annotation instead of a type of click.
    described = parameter.type_descriptor
    element = (get_args(described.annotation) or (described.annotation,))[0]
    name = described.path_type if described.is_path else getattr(element, "__name__", "")
    limits = described.parameter_info.min, described.parameter_info.max
    return words.get(name, name), described.choices, *limits


def overview() -> str:
    """Return a table of gsgen's commands, each with the first sentence of its help."""
    rows = []
    for entry in _commands():
        rows.append((f"[`gsgen {entry.name}`](#gsgen-{entry.name})", entry.summary))
    return table(("command", "what it does"), rows)


def besides(*described: str) -> str:
    """Return a section for each command that the page does not describe itself."""
    parts = []
    for entry in _commands():
        if entry.name not in described:
            parts.append(_section(entry.name))
            for name in getattr(_find(entry.name), "commands", ()):
                parts.append(_section(entry.name, name))
    return "\n\n".join(parts)


def _section(*words: str) -> str:
    """Return the section of a command, one level lower for a command of a group."""
    head = f"##{'#' * (len(words) - 1)} gsgen {' '.join(words)}"
    return f"{head}\n\n{inspect.cleandoc(_find(*words).help)}\n\n{command(*words)}"


def plugins() -> str:
    """Return one section for each method that ``gsgen export`` knows."""
    parts = []
    for point in _ours("gsgen.generators"):
        plugin = point.load()
        head = f"### gsgen export {point.name}\n\n{plugin.headline} {plugin.reads}"
        parts.append(f"{head}\n\n{command('export', point.name)}")
    return "\n\n".join(parts)


def plugin_table() -> str:
    """Return the methods that ``gsgen export`` knows, each with its page."""
    rows = []
    for point in _ours("gsgen.generators"):
        plugin = point.load()
        inputs = code(plugin.inputs) or "none"
        link = f"[{point.name}]({point.name}.md)"
        rows.append((link, plugin.headline, inputs, _cited(plugin.publication)))
    columns = ("plugin", "what it exports", "inputs of the model", "paper, code and its licence")
    return table(columns, rows)


def plugin_list() -> str:
    """Return the methods that ``gsgen export`` knows in one line each, for the README."""
    rows = []
    for point in _ours("gsgen.generators"):
        link = f"[{point.name}](docs/plugins/{point.name}.md)"
        rows.append((link, point.load().headline))
    return table(("`gsgen export …`", "what it exports"), rows)


def _cited(publication: Publication) -> str:
    """Return paper, code and licence with links."""
    paper, address = publication.paper, publication.code
    if publication.arxiv:
        paper += f", [arXiv {publication.arxiv}](https://arxiv.org/abs/{publication.arxiv})"
    repository = address.removeprefix("https://github.com/")
    source = f"[{repository}]({address}), {publication.licence}" if address else ""
    return "; ".join(filter(None, (paper, source))) or "–"
