"""`gsgen export`: write a torch module, or the checkpoint of a method, as an ONNX generator."""

__all__ = ["app"]

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from typer.core import TyperCommand, TyperGroup

from gsgen.cli.command_group import PASS_THROUGH_SETTINGS, refusing, runnable, usable_command
from gsgen.cli.commands.exporting.export_html import export_html
from gsgen.cli.commands.exporting.export_options import with_common_options
from gsgen.cli.commands.exporting.plugin_function import plugin_function
from gsgen.cli.option_panels import escape_markup
from gsgen.cli.output import echo
from gsgen.cli.output_hints import command_that_writes
from gsgen.contract._entry_points import Extension, ExtensionUnusable
from gsgen.contract._safe_text import for_shell
from gsgen.contract.errors import ExitCode, UnknownName, names_meant
from gsgen.contract.process.atomic_files import MODEL_SUFFIX
from gsgen.sdk.plugins.factory import is_target
from gsgen.sdk.plugins.plugin import Plugin, find_plugins, words_of_plugins

_HELP_TEXT = """Export a Gaussian Generator from your torch module, or from the files of a method.

TARGET is package.module:factory, a callable of yours that returns a GaussianGenerator (modules
of the current folder can be imported), or one of the methods below.
"""

_MODULE_WORDS: Final = ("torch", "pytorch", "module", "python", "model", "onnx", "checkpoint")
_FORMAT_WORDS: Final = {"html": "page web website webpage viewer embed"}


class _TargetCommands(TyperGroup):
    """The command group of `gsgen export`: all installed plugins, and any ``module:factory``."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the formats and of all plugins that packages register."""
        return [*super().list_commands(ctx), *find_plugins()]

    _is_listing = False

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return the command that exports a format or a method, whose plugin is imported."""
        plugin = find_plugins().get(cmd_name)
        if plugin is None:
            return super().get_command(ctx, cmd_name)
        return _plugin_summary(plugin) if self._is_listing else _plugin_command(plugin)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help, with a summary of each method."""
        self._is_listing = True
        super().format_help(ctx, formatter)

    def shell_complete(self, ctx: Any, incomplete: str) -> Any:
        """Return the names that a word may be completed to, with a summary of each method."""
        self._is_listing = True
        return super().shell_complete(ctx, incomplete)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Move the argument TARGET before the options if options precede it on the command line."""
        names = self.list_commands(ctx)
        known_words = [word for word in args if word in names or is_target(word)]
        if args and args[0].startswith("-") and known_words:
            position = args.index(known_words[0])
            args = [args[position], *args[:position], *args[position + 1 :]]
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that exports a method or a ``module:factory``; raise if unknown."""
        word, names = args[0], self.list_commands(ctx)
        if word not in names and is_target(word):
            wants_help = bool({"-h", "--help"} & set(args))
            return word, _export_command(word, wants_help=wants_help), args[1:]
        if word in names or word.startswith("-"):
            return super().resolve_command(ctx, args)
        words = words_of_plugins() | _FORMAT_WORDS
        match names_meant(word, words):
            case [name]:
                echo(f"note: {word} is exported by {name}", err=True)
                return super().resolve_command(ctx, [name, *args[1:]])
            case []:
                raise _unknown_target_error(word, names, args)
            case _:
                raise UnknownName.among("target", word, names, "TARGET", words)


def _unknown_target_error(word: str, plugins: list[str], typed_words: list[str]) -> UnknownName:
    from gsgen.formats.codecs import codec_of_suffix

    listing = "`gsgen plugins` lists the methods."
    error = UnknownName.among("target", word, plugins, "TARGET", listing=listing)
    path = Path(word)
    module, _, name = word.rpartition(".")
    option = next((flag for flag in ("-o", "--output") if flag in typed_words[:-1]), "")
    is_source = path.exists() or codec_of_suffix(path)
    output = Path("model.onnx")
    if option:
        output = Path(typed_words[typed_words.index(option) + 1])
    elif typed_words[1:] and not is_source:  # perhaps a format, as in `gsgen export spz a.ply`
        output = Path(f"{Path(typed_words[1]).stem}.{word.replace('-', '.')}")
    call = command_that_writes(output, [word] if is_source else typed_words[1:2])
    if call and output.suffix.lower() != MODEL_SUFFIX:
        hint = f"`{call}` writes such a file."
    elif path.is_dir():
        hint = (
            f"Name the method that trained it, static for 3DGS: gsgen export static {for_shell(word)} "
            f"-o {output}; `gsgen plugins` lists all."
        )
    elif codec_of_suffix(path):
        hint = f"Name the method that the file belongs to: gsgen export static {word} -o …"
    elif path.suffix == MODEL_SUFFIX:
        hint = f"It is already exported: gsgen validate {for_shell(word)}"
    elif path.suffix == ".py" or _is_module(word):
        hint = f"Name the callable that returns the generator: {word}:NAME"
    elif _is_module(module) or (module and "Did you mean" not in error.hint):
        hint = f"Write {module}:{name}"
    elif word in _MODULE_WORDS:
        hint = "A module of your own is written package.module:factory."
    else:
        hint = f"{error.hint} A target of your own is written package.module:factory."
    return UnknownName(error.message, where=error.where, hint=hint)


def _is_module(name: str) -> bool:
    """Return whether a dotted name is that of a Python file under the current folder."""
    return Path(f"{name.replace('.', '/')}.py").is_file()


def _export_command(target: str, *, wants_help: bool) -> Any:
    """Return the command that exports ``module:factory``, which is imported when it runs."""
    single_command_app = typer.Typer(add_completion=False)
    resources = ExitStack()
    entry = typer.Option(
        "--arg",
        metavar="KEY=VALUE",
        help="An argument of the factory, typed as it declares; repeatable.",
    )

    stub = typer.Option(
        "--stub",
        metavar="MODULE,…",
        help="Packages that are not installed and not called, such as kernels of CUDA; repeatable.",
    )

    def build(
        arg: Annotated[list[str] | None, entry] = None,
        stub: Annotated[list[str] | None, stub] = None,
    ) -> Any:
        from gsgen.sdk.plugins.factory import load_factory, require_torch
        from gsgen.sdk.plugins.stand_ins import stand_ins

        require_torch()
        from gsgen.sdk.authoring.on_cpu import on_cpu

        # forward may import the packages, too, so the stand-ins stay until the export ends.
        names = [name for names in stub or () for name in names.split(",")]
        resources.enter_context(stand_ins(names))
        with on_cpu():
            factory = load_factory(target)
            return factory.build(factory.arguments(arg or []))

    def run(module: Any, request: Any) -> None:
        from gsgen.cli.commands.exporting.export_job import run_export

        with resources:
            run_export(module, request, target)

    function = with_common_options(build, run)
    help = f"Export the result of {target}."
    if wants_help:
        help += f"\n\n{_describe_target(target)}"
    single_command_app.command(target, help=escape_markup(help))(function)
    command: Any = typer.main.get_command(single_command_app)
    return command


def _describe_target(target: str) -> str:
    """Return a sentence about the arguments that a user's torch generator factory takes."""
    from gsgen.sdk.plugins.factory import load_factory

    parameters = load_factory(target).parameters.values()
    if not parameters:
        return "It takes no arguments."
    return f"It takes --arg {', --arg '.join(str(parameter) for parameter in parameters)}."


def _plugin_summary(extension: Extension) -> Any:
    """Import a plugin, and return a command for a list: it has a help, but no options."""
    loaded_plugin, _ = runnable(extension)
    if not isinstance(loaded_plugin, Plugin):
        return _plugin_command(extension)
    return TyperCommand(extension.name, help=loaded_plugin.headline)


def _plugin_command(extension: Extension) -> Any:
    """Import a plugin, and return the click command that exports its method, or reports why not."""
    loaded_plugin, settings = runnable(extension)
    help = None
    if isinstance(loaded_plugin, Plugin):
        try:
            function = plugin_function(loaded_plugin)
        except TypeError as error:
            message = f"plugin {loaded_plugin.name!r} cannot be used: {error}"
            unusable_error = ExtensionUnusable(message, loaded_plugin.headline, ExitCode.USAGE)
            function, settings = refusing(unusable_error), PASS_THROUGH_SETTINGS
        help = f"{loaded_plugin.headline}\n\n{loaded_plugin.reads}"
        loaded_plugin = function
    return usable_command(extension, loaded_plugin, settings, help=help)


app = typer.Typer(
    cls=_TargetCommands,
    help=_HELP_TEXT,
    no_args_is_help=True,
    subcommand_metavar="TARGET -o OUTPUT [OPTIONS]",
)
app.command("html")(export_html)


@app.callback()
def _root_command() -> None:
    pass
