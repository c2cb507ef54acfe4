"""Prints `gsgen --help` from the table of commands, without importing a command or typer."""

__all__ = ["print_help"]

from collections.abc import Iterable
from typing import Final

from rich.console import Console
from rich.padding import Padding
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from gsgen.cli.command_table import Command, panels
from gsgen.contract._safe_text import printable

_HELP_SUMMARY: Final = (
    "Export, validate and draw Gaussian Generators: ONNX models that emit 3D Gaussians."
)
_ROOT_OPTIONS: Final = (
    ("--version", "Show the version and exit."),
    ("--install-completion", "Install completion for the current shell."),
    ("--show-completion", "Show completion for the current shell, to copy or customise it."),
    ("--help, -h", "Show this message and exit."),
)


def print_help() -> None:
    """Print the options and the commands of the `gsgen` program, and what is not installed."""
    console = Console(highlight=False)
    commands = panels()
    width = max(len(command.name) for panel in commands.values() for command in panel)
    console.print(Padding(Text("Usage: gsgen [OPTIONS] COMMAND [ARGS]...", "bold"), 1))
    console.print(Padding(Text(_HELP_SUMMARY), (0, 1, 1, 1)))
    console.print(_help_panel("Options", _ROOT_OPTIONS))
    for title, panel in commands.items():
        rows = ((command.name, command.summary) for command in panel)
        console.print(_help_panel(title, rows, width))
    if note := missing_note(command for panel in commands.values() for command in panel):
        console.print(Padding(Text(printable(note)), 1))


def _help_panel(title: str, rows: Iterable[tuple[str, str]], width: int | None = None) -> Panel:
    """Return a frame with a heading around rows of two columns: names, and what they mean."""
    table = Table.grid(padding=(0, 2, 0, 0))
    table.add_column(style="bold cyan", no_wrap=True, min_width=width)
    table.add_column()
    for name, meaning in rows:
        table.add_row(Text(printable(name)), Text(printable(meaning)))
    return Panel(table, title=title, title_align="left", border_style="dim")


def missing_note(commands: Iterable[Command]) -> str:
    """Return which commands lack packages, and how to install these; empty if none does."""
    missing: dict[str, list[str]] = {}
    for command in commands:
        if command.code.missing:
            missing.setdefault(command.code.install_hint, []).append(command.name)
    lines = [f"{', '.join(names)}: {install_hint}" for install_hint, names in missing.items()]
    return f"Not installed here: {'; '.join(lines)}" if lines else ""
