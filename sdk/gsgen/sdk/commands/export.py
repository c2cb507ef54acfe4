"""`gsgen export`: write a torch module, or the checkpoint of a method, as an ONNX generator."""

__all__ = ["app"]

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from gsgen.contract._entry_points import registered_entry_points
from gsgen.contract._extensions import escape_markup
from gsgen.contract.errors import GsgenError, UnknownName
from gsgen.contract.process.atomic_files import PAGE_SUFFIXES
from gsgen.sdk.plugins.export_options import with_common_options
from gsgen.sdk.plugins.factory import is_target
from gsgen.sdk.plugins.plugin import Plugin, find_plugins

_FORMATS_GROUP = "gsgen.export_formats"  # commands that write models for other programs
_HELP = """Export a Gaussian Generator from your torch module, or from the files of a method.

TARGET is package.module:factory, a callable of yours that returns a GaussianGenerator (modules
of the current folder can be imported), or one of the methods below.
"""
# A command that only reports why it cannot run accepts all arguments.
_ANY_WORDS = {"ignore_unknown_options": True, "allow_extra_args": True}


class _Targets(TyperGroup):
    """The command group of `gsgen export`: all installed plugins, and any ``module:factory``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Move the argument TARGET before the options if options precede it on the command line."""
        known = [word for word in args if word in self.commands or is_target(word)]
        if args and args[0].startswith("-") and known:
            position = args.index(known[0])
            args = [args[position], *args[:position], *args[position + 1 :]]
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that exports a method or a ``module:factory``; raise if unknown."""
        word = args[0]
        if word not in self.commands and is_target(word):
            wants_help = bool({"-h", "--help"} & set(args))
            return word, _command_for(word, wants_help=wants_help), args[1:]
        if word not in self.commands and not word.startswith("-"):
            raise _unknown(word, list(self.commands), args)
        return super().resolve_command(ctx, args)


def _unknown(word: str, plugins: list[str], typed: list[str]) -> UnknownName:
    from gsgen.formats.codecs import codec_of_suffix

    error = UnknownName.among("target", word, plugins, "TARGET")
    path = Path(word)
    module, _, name = word.rpartition(".")
    pages = [entry for entry in typed if Path(entry).suffix.lower() in PAGE_SUFFIXES]
    if pages and path.suffix:
        hint = f"`gsgen export html {word} -o {pages[0]}` writes a page."
    elif codec_of_suffix(path):
        hint = f"Name the method that the file belongs to: gsgen export static {word} -o …"
    elif path.suffix == ".onnx":
        hint = f"It is already exported: gsgen validate {word}"
    elif path.suffix == ".py" or _is_module(word):
        hint = f"Name the callable that returns the generator: {word}:NAME"
    elif _is_module(module) or (module and "Did you mean" not in error.hint):
        hint = f"Write {module}:{name}"
    else:
        hint = f"{error.hint} A target of your own is written package.module:factory."
    return UnknownName(error.message, where=error.where, hint=hint)


def _is_module(name: str) -> bool:
    """Return whether a dotted name is that of a Python file under the current folder."""
    return Path(f"{name.replace('.', '/')}.py").is_file()


def _command_for(target: str, *, wants_help: bool) -> Any:
    """Return the command that exports ``module:factory``, which is imported when it runs."""
    single = typer.Typer(add_completion=False)
    entry = typer.Option(
        "--arg",
        metavar="KEY=VALUE",
        help="An argument of the factory, typed as it declares; repeatable.",
    )

    def build(arg: Annotated[list[str] | None, entry] = None) -> Any:
        from gsgen.sdk.plugins.factory import load_factory

        factory = load_factory(target)
        return factory.build(factory.arguments(arg or []))

    def run(module: Any, request: Any) -> None:
        from gsgen.sdk.plugins.export_job import run_export

        run_export(module, request, target)

    function = with_common_options(build, run)
    help = f"Export the result of {target}."
    if wants_help:
        help += f"\n\n{_described(target)}"
    single.command(target, help=escape_markup(help))(function)
    command: Any = typer.main.get_command(single)
    return command


def _described(target: str) -> str:
    """Return a sentence about the arguments that a user's torch generator factory takes."""
    from gsgen.sdk.plugins.factory import load_factory

    parameters = load_factory(target).parameters.values()
    if not parameters:
        return "It takes no arguments."
    return f"It takes --arg {', --arg '.join(str(parameter) for parameter in parameters)}."


def _function_of(plugin: Plugin) -> tuple[Callable[..., Any], dict[str, Any]]:
    """Return the export function of a plugin, or one that raises the plugin's error."""
    try:
        return plugin.function, {}
    except TypeError as error:
        message = f"plugin {plugin.name!r} cannot be used: {error}"

    def refuse() -> None:
        raise GsgenError(message)

    return refuse, _ANY_WORDS


def _build() -> typer.Typer:
    group = typer.Typer(
        cls=_Targets,
        help=_HELP,
        no_args_is_help=True,
        subcommand_metavar="TARGET -o OUTPUT [OPTIONS]",
    )

    @group.callback()
    def _root() -> None:
        pass

    for point in registered_entry_points(_FORMATS_GROUP):
        group.command(point.name)(point.load())
    for name, command in find_plugins().items():
        loaded = command.load()
        if isinstance(loaded, Plugin):
            help = f"{loaded.headline}\n\n{loaded.reads}"
            function, context = _function_of(loaded)
            group.command(name, help=help, context_settings=context)(function)
        elif isinstance(loaded, typer.Typer):
            group.add_typer(loaded, name=name)
        else:  # a plugin that cannot be used reports the reason itself
            group.command(name, context_settings=_ANY_WORDS)(loaded)
    return group


app = _build()
