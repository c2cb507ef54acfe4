"""The typer program behind `gsgen`: a group of commands that imports only the one that runs."""

__all__ = [
    "PASS_THROUGH_SETTINGS", "CommandEndedEarly", "build", "click_command", "refusing", "runnable",
    "usable_command", "with_fetched_inputs",
]  # fmt: skip

import functools
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from gsgen.cli.command_table import Command, find_command, panels
from gsgen.cli.options import OPTION_ORDER
from gsgen.contract._entry_points import (
    Extension,
    ExtensionUnusable,
    plugin_exits_as_errors,
    short_repr,
)
from gsgen.contract._safe_text import for_shell, printable
from gsgen.contract.errors import ExitCode, UnknownName

# A command that only reports why it cannot run accepts all arguments.
PASS_THROUGH_SETTINGS = {"ignore_unknown_options": True, "allow_extra_args": True}


def build() -> typer.Typer:
    """Return the `gsgen` program as a typer app, whose commands are imported when they run."""
    app = typer.Typer(
        name="gsgen",
        cls=_CommandGroup,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root_command)
    return app


def _root_command() -> None:
    pass


class CommandEndedEarly(SystemExit):
    """Raised if other code than a command's own ended the command, which decided nothing."""

    def __init__(self, command: str) -> None:
        super().__init__(ExitCode.INTERNAL)
        self.command = command


class _CommandGroup(TyperGroup):
    """A click command group that loads a command when it is asked for."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, in the order of the help."""
        return [command.name for commands in panels().values() for command in commands]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Import the command ``cmd_name``, and return it as a click command; None if unknown."""
        command = find_command(cmd_name)
        return None if command is None else click_command(command)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the first argument names; raise for an unknown name."""
        if not args[0].startswith("-") and find_command(args[0]) is None:
            raise _unknown_command(args[0], self.list_commands(ctx))
        return super().resolve_command(ctx, args)

    def make_context(
        self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any
    ) -> Any:
        """Parse the command line; an error quotes arguments with escape sequences."""
        with _printable_errors():
            return super().make_context(info_name, args, parent, **extra)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; a SystemExit of code that it runs, such as a plugin's, is a crash."""
        try:
            with _printable_errors():
                return super().invoke(ctx)
        except SystemExit as error:
            if isinstance(error.__context__, BrokenPipeError):  # rich ends the process for a pipe
                raise
            command = find_command(ctx.invoked_subcommand or "")
            if command is not None and command.code.owner != "gsgen":
                raise
            raise CommandEndedEarly(ctx.invoked_subcommand or "") from error


@contextmanager
def _printable_errors() -> Iterator[None]:
    """Escape the messages of click's errors, which quote arguments such as names of files."""
    try:
        yield
    except Exception as error:
        if hasattr(error, "format_message") and hasattr(error, "message"):
            error.message = printable(str(error.message), kept_chars="\n\t")
        raise


def click_command(command: Command) -> Any:
    """Import a command, and return it as a click command."""
    loaded_command, settings = runnable(command.code)
    return usable_command(command.code, loaded_command, settings, cls=_OrderedCommand)


def usable_command(
    extension: Extension,
    loaded: object,
    settings: dict[str, Any],
    *,
    cls: type[TyperCommand] = TyperCommand,
    help: str | None = None,
) -> Any:
    """Return the click command of a function or typer app, or one that says why it cannot run.

    Args:
        extension: Its name and entry point.
        loaded: The object that the extension names: a third party may register any.
        settings: Context settings of a function.
        cls: The class of a function's command.
        help: The help of a function, in place of its docstring.
    """
    try:
        with plugin_exits_as_errors():
            return _click_command(extension.name, loaded, settings, cls, help)
    except Exception as error:  # typer refuses annotations that it does not know, for example
        reason = str(error) if isinstance(error, TypeError) else short_repr(error)
        message = f"`{extension.name}` ({extension.point.value}) is not a command: {reason}"
        function = refusing(ExtensionUnusable(message, f"Broken: {reason}", ExitCode.INTERNAL))
        return _click_command(extension.name, function, PASS_THROUGH_SETTINGS, cls, None)


def _click_command(
    name: str, loaded: Any, settings: dict[str, Any], cls: type[TyperCommand], help: str | None
) -> Any:
    app = typer.Typer(add_completion=False)
    if isinstance(loaded, typer.Typer):
        from gsgen.cli.option_panels import arrange_options

        app.add_typer(loaded, name=name)
        group = typer.main.get_group(app).commands[name]
        arrange_options(group)
        return with_fetched_inputs(group)
    if not callable(loaded):
        raise TypeError(f"{short_repr(loaded)}, expected a function or a typer.Typer")
    app.command(name, cls=cls, help=help, context_settings=settings)(loaded)
    return with_fetched_inputs(typer.main.get_group(app).commands[name])


def with_fetched_inputs(command: Any) -> Any:
    """Let a click command and its subcommands fetch the inputs that are addresses; return it."""
    for subcommand in getattr(command, "commands", {}).values():
        with_fetched_inputs(subcommand)
    if command.callback is not None and not hasattr(command, "commands"):
        # Only click's type of paths has this attribute.
        paths = {item.name for item in command.params if hasattr(item.type, "resolve_path")}
        command.callback = _fetching(command.callback, paths)
    return command


def _fetching(run: Callable[..., Any], path_parameters: set[str]) -> Callable[..., Any]:
    """Return a command's function that fetches its inputs before it runs."""

    @functools.wraps(run)
    def fetch_and_run(**values: Any) -> Any:
        if any(map(_may_be_remote, values.values())):
            from gsgen.cli.fetched_inputs import fetch_inputs

            values = fetch_inputs(values, path_parameters)
        return run(**values)

    return fetch_and_run


def _may_be_remote(value: Any) -> bool:
    """Return whether a text, or one of several, may be an address or the path of an archive."""
    if isinstance(value, list | tuple):
        return any(map(_may_be_remote, value))
    is_text = isinstance(value, str | os.PathLike)
    return is_text and (":/" in os.fspath(value) or os.fspath(value).lower().endswith(".zip"))


def runnable(extension: Extension) -> tuple[Any, dict[str, Any]]:
    """Load an extension; return it with context settings, or a function that says what it lacks."""
    try:
        return extension.load(), {}
    except ExtensionUnusable as error:
        return refusing(error), PASS_THROUGH_SETTINGS


def refusing(error: ExtensionUnusable) -> Callable[..., None]:
    """Return a typer function that accepts any words, and raises an error."""

    def refuse(words: Annotated[list[str] | None, typer.Argument(hidden=True)] = None) -> None:
        raise error

    refuse.__doc__ = printable(error.summary).replace("[", r"\[")  # rich would read markup
    return refuse


class _OrderedCommand(TyperCommand):
    """A click command that records in which order the user typed its options."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Print the help of the command, with its options in panels."""
        from gsgen.cli.option_panels import arrange_options

        arrange_options(self)
        super().format_help(ctx, formatter)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse command-line arguments, and record parameter names in the order typed."""
        typed_args = list(args)
        values, _, order = self.make_parser(ctx).parse_args(args=list(args))
        ctx.meta[OPTION_ORDER] = [parameter.name for parameter in order]
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as error:
            error.message += _number_hint(error.message, error.param)
            if not error.message and getattr(error.param, "name", None) == "output":
                from gsgen.cli.output_hints import output_hint

                error.message = output_hint(self.name or "", typed_args, values)
            error.param = self._missing_argument(error.param, values)
            raise

    def _missing_argument(self, missing: Any, values: dict[str, Any]) -> Any:
        """Return the parameter that the user left out, for the one that click misses.

        A single value of ``SOURCE… TARGET`` is the last argument to click, and SOURCE to the user.
        """
        arguments = [item for item in self.params if item.param_type_name == "argument"]
        if missing not in arguments[:-1] or values[missing.name or ""]:
            return missing
        last_argument = arguments[-1]
        return (
            last_argument if missing.nargs == -1 and values[last_argument.name or ""] else missing
        )


def _number_hint(message: str, parameter: Any) -> str:
    """Return the type and the range of a number that an option or argument refused, else nothing.

    The range is kept in the parameter's type until typer 0.28, and in the parameter since.
    """
    if "valid int" in message:
        noun = "a whole number"
    elif "valid float" in message or "valid number" in message:
        noun = "a number"
    elif "should be greater" in message or "should be less" in message:
        noun = "a value"
    else:
        return ""
    bounds = parameter if hasattr(parameter, "min") else getattr(parameter, "type", None)
    least, most = getattr(bounds, "min", None), getattr(bounds, "max", None)
    lower_text = "" if least is None else f" from {least:g}"
    return f"{'' if message.endswith('.') else '.'} Give {noun}{lower_text}{'' if most is None else f' to {most:g}'}."


def _unknown_command(name: str, commands: list[str]) -> UnknownName:
    error = UnknownName.among("command", name, commands)
    if os.path.exists(name):
        word = for_shell(name)
        is_model_path = name.endswith((".onnx", ".json")) or os.path.isdir(name)
        draw_hint = f"To draw the file, type `gsgen render {word} -o picture.png`."
        error.hint = (
            f"To validate it, type `gsgen validate {word}`." if is_model_path else draw_hint
        )
    return error
