"""`gsgen export`: turn a method's files into a generator, one subcommand a plugin."""

__all__ = ["app"]

import typer

from gsgen.sdk.plugin import Plugin, find_plugins


def _build() -> typer.Typer:
    made = typer.Typer(
        help="Export a Gaussian Generator from the files of a method.", no_args_is_help=True
    )

    @made.callback()
    def _root() -> None:
        pass

    for name, command in find_plugins().items():
        if command.missing:
            made.command(name, context_settings=command.context)(command.load())
            continue
        plugin = command.point.load()
        if isinstance(plugin, Plugin):
            made.command(name, help=f"{plugin.summary}\n\n{plugin.reads}")(plugin.command)
    return made


app = _build()
