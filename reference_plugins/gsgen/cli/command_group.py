"""The typer program behind `gsgen`: a group of commands that imports only the one that runs."""

__all__ = [
    "PASS_THROUGH_SETTINGS", "CommandEndedEarly", "SubcommandGroup", "build", "click_command", "refusing", "runnable",
    "usable_command", "with_fetched_inputs",
]  # fmt: skip

import functools
import math
import os
import re
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from typer.core import TyperCommand, TyperGroup

from gsgen.cli.command_table import PANELS, Command, advice_on, calls_meant, find_command, panels
from gsgen.cli.options import OPTION_ORDER, with_known_values
from gsgen.contract._entry_points import (
    Extension,
    ExtensionUnusable,
    plugin_exits_as_errors,
    short_repr,
)
from gsgen.contract._safe_text import for_shell, printable
from gsgen.contract.errors import ConfigInvalid, ExitCode, UnknownName

# A command that only reports why it cannot run accepts all arguments.
PASS_THROUGH_SETTINGS = {"ignore_unknown_options": True, "allow_extra_args": True}

_MAX_NAMED_COMMANDS: Final = 3
_NUMBER: Final = re.compile(r"[-+]?\d*\.?\d+")
_RULE_ID: Final = re.compile(r"G[A-Z]\d{3}")


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
            raise _unknown_command(args, self.list_commands(ctx))
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


class SubcommandGroup(TyperGroup):
    """A group of commands below one of gsgen's, such as tiles, whose errors name the call that was meant."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command that the first argument names; raise for an unknown name."""
        if not args[0].startswith("-") and args[0] not in self.commands:
            raise _unknown_command(args, list(self.commands), self.name or "")
        return super().resolve_command(ctx, args)


@contextmanager
def _printable_errors() -> Iterator[None]:
    """Escape the messages of click's errors, which quote arguments; name options that were meant."""
    try:
        yield
    except Exception as error:
        if hasattr(error, "option_name") and getattr(error, "ctx", None) is not None:
            from gsgen.cli.option_words import explain_option

            explain_option(error, _commands_with)
        if "unexpected extra argument" in str(getattr(error, "message", "")):
            _name_arguments(error)
        if hasattr(error, "format_message") and hasattr(error, "message"):
            error.message = printable(str(error.message), kept_chars="\n\t")
        raise


def _name_whole_option(error: Any, typed_args: list[str]) -> None:
    """Name an unknown option such as ``-ss`` as it was typed: click takes it for the letter ``-s``."""
    option = str(getattr(error, "option_name", ""))
    if len(option) == 2 and option not in typed_args:
        words = [word for word in typed_args if word.startswith(option) and word[1:].isidentifier()]
        for word in words[:1]:
            error.option_name, error.message = word, f"No such option: {word}"


def _name_arguments(error: Any) -> None:
    """Append the arguments of the command to an error about one too many."""
    names = [
        item.make_metavar(error.ctx).upper()
        for item in error.ctx.command.params
        if item.param_type_name == "argument"
    ]
    error.message += f". It takes {' '.join(names) or 'options alone'}."


def _commands_with(option: str) -> list[str]:
    """Return the names of a few of gsgen's commands that have an option; it imports them."""
    commands = [command for panel in PANELS.values() for command in panel]
    names = (
        call
        for entry in commands
        for call, command in _calls_of(entry.name, click_command(entry))
        if any(option in item.opts for item in command.params)
    )
    return list(islice(names, _MAX_NAMED_COMMANDS))


def _calls_of(name: str, command: Any) -> list[tuple[str, Any]]:
    """Return a command and its subcommands, each with the words that call it."""
    subcommands = getattr(command, "commands", {})
    return [(name, command), *((f"{name} {word}", item) for word, item in subcommands.items())]


def click_command(command: Command) -> Any:
    """Import a command, and return it as a click command."""
    loaded_command, settings = runnable(command.code)
    return usable_command(command.code, loaded_command, settings)


def usable_command(
    extension: Extension, loaded: object, settings: dict[str, Any], *, help: str | None = None
) -> Any:
    """Return the click command of a function or typer app, or one that says why it cannot run.

    Args:
        extension: Its name and entry point.
        loaded: The object that the extension names: a third party may register any.
        settings: Context settings of a function.
        help: The help of a function, in place of its docstring.
    """
    try:
        with plugin_exits_as_errors():
            return _click_command(extension.name, loaded, settings, help)
    except Exception as error:  # typer refuses annotations that it does not know, for example
        reason = str(error) if isinstance(error, TypeError) else short_repr(error)
        message = f"`{extension.name}` ({extension.point.value}) is not a command: {reason}"
        function = refusing(ExtensionUnusable(message, f"Broken: {reason}", ExitCode.INTERNAL))
        return _click_command(extension.name, function, PASS_THROUGH_SETTINGS, None)


def _click_command(name: str, loaded: Any, settings: dict[str, Any], help: str | None) -> Any:
    app = typer.Typer(add_completion=False)
    if isinstance(loaded, typer.Typer):
        from gsgen.cli.option_panels import arrange_options

        app.add_typer(loaded, name=name)
        group = typer.main.get_group(app).commands[name]
        arrange_options(group)
        return with_fetched_inputs(group)
    if not callable(loaded):
        raise TypeError(f"{short_repr(loaded)}, expected a function or a typer.Typer")
    app.command(name, cls=_OrderedCommand, help=help, context_settings=settings)(loaded)
    return with_fetched_inputs(typer.main.get_group(app).commands[name])


def with_fetched_inputs(command: Any) -> Any:
    """Return a click command that fetches inputs at addresses, and refuses endless numbers.

    So do its subcommands.
    """
    for subcommand in getattr(command, "commands", {}).values():
        with_fetched_inputs(subcommand)
    if command.callback is not None and not hasattr(command, "commands"):
        # Only click's type of paths has this attribute.
        paths = {item.name for item in command.params if hasattr(item.type, "resolve_path")}
        texts = {item.name for item in command.params if getattr(item.type, "allow_dash", False)}
        ranges = {item.name: item.opts[0] for item in command.params if _has_range(item)}
        command.callback = _fetching(command.callback, paths, texts, ranges)
    return command


def _has_range(parameter: Any) -> bool:
    bounds = _bounds_of(parameter)
    return any(getattr(bounds, name, None) is not None for name in ("min", "max"))


def _bounds_of(parameter: Any) -> Any:
    """Return what has the range of a number: until typer 0.28 the type, since then the parameter."""
    return parameter if hasattr(parameter, "min") else getattr(parameter, "type", None)


def _fetching(
    run: Callable[..., Any],
    path_parameters: set[str],
    text_outputs: set[str],
    ranges: dict[str, str],
) -> Callable[..., Any]:
    """Return a command's function that fetches its inputs before it runs.

    ``text_outputs`` are parameters for which ``-`` means standard output, ``ranges`` the options of
    those that have a range: click lets NaN through, and infinity where there is no maximum.
    """

    @functools.wraps(run)
    def fetch_and_run(**values: Any) -> Any:
        for name, option in ranges.items():
            if isinstance(value := values.get(name), float) and not math.isfinite(value):
                raise ConfigInvalid(f"is {value}, expected a finite number", where=option)
        if any(map(_may_be_remote, values.values())):
            from gsgen.cli.fetched_inputs import fetch_inputs

            values = fetch_inputs(values, path_parameters, text_outputs)
        return run(**values)

    return fetch_and_run


def _may_be_remote(value: Any) -> bool:
    """Return whether a text, or one of several, may be an address, in an archive, or a pipe's."""
    if isinstance(value, list | tuple):
        return any(map(_may_be_remote, value))
    if not isinstance(value, str | os.PathLike):
        return False
    text = os.fspath(value)
    return text == "-" or ":/" in text or ".zip" in text.lower()


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
        try:
            args = self._with_named_options(ctx, self._with_joined_numbers(with_known_values(args)))
        except Exception as error:
            if getattr(error, "ctx", ctx) is None:
                error.ctx = ctx  # type: ignore[attr-defined]  # for explain_option
            _name_whole_option(error, typed_args)
            raise
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
            error.message = error.message or getattr(error.param, "help", None) or ""
            raise

    def _with_joined_numbers(self, args: list[str]) -> list[str]:
        """Return the arguments with ``--translate 1 0 0``, for example, written as ``1,0,0``."""
        counts = {
            option: str(item.metavar).count(",") + 1
            for item in self.params
            for option in item.opts
            if item.param_type_name == "option" and "," in str(item.metavar)
        }
        joined = list(args)
        for position in (index for index, word in enumerate(args) if word in counts):
            numbers = args[position + 1 : position + 1 + counts[args[position]]]
            if len(numbers) == counts[args[position]] and all(map(_NUMBER.fullmatch, numbers)):
                start = len(joined) - len(args) + position + 1
                joined[start : start + len(numbers)] = [",".join(numbers)]
        return joined

    def _with_named_options(self, ctx: Any, args: list[str]) -> list[str]:
        """Return the arguments with ``--checkpoint`` or ``--output`` before a word that names such.

        They may be left out where a command has no argument for the word, and ``--checkpoint`` may
        be typed before one. A command whose last argument is TARGET takes ``--output`` in its place.
        """
        names = {parameter.name for parameter in self.params}
        arguments = [item.name for item in self.params if item.param_type_name == "argument"]
        if arguments and "checkpoint" not in names:  # which is the argument here
            args = [word for word in args if word != "--checkpoint"]
        values, extra_words, _ = self.make_parser(ctx).parse_args(args=list(args))
        if arguments[-1:] == ["target"] and values.get("output"):
            return [*args, values["output"]]
        for name in ("checkpoint", "output"):
            if len(extra_words) in (1, 2) and name in names and values.get(name) is None:
                args, extra_words = self._with_named_option(ctx, args, extra_words, name)
        return args

    def _with_named_option(
        self, ctx: Any, args: list[str], extra_words: list[str], name: str
    ) -> tuple[list[str], list[str]]:
        """Write ``--name`` before the first extra word, of those that are equal to it."""
        word = extra_words[0]
        for position in (index for index, entry in enumerate(args) if entry == word):
            named_args = [f"--{name}", word, *args[:position], *args[position + 1 :]]
            values, remaining_words, _ = self.make_parser(ctx).parse_args(args=list(named_args))
            if values.get(name) == word and remaining_words == extra_words[1:]:
                return named_args, remaining_words
        return args, extra_words

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
    """Return the type and the range of a number that an option or argument refused, else nothing."""
    if "valid int" in message:
        noun = "a whole number"
    elif "valid float" in message or "valid number" in message:
        noun = "a number"
    elif "should be greater" in message or "should be less" in message:
        noun = "a value"
    else:
        return ""
    bounds = _bounds_of(parameter)
    least, most = getattr(bounds, "min", None), getattr(bounds, "max", None)
    lower_text = "" if least is None else f" from {least:g}"
    return f"{'' if message.endswith('.') else '.'} Give {noun}{lower_text}{'' if most is None else f' to {most:g}'}."


def _unknown_command(typed_words: list[str], commands: list[str], group: str = "") -> UnknownName:
    """Return the error for an unknown command: its hint is the call that was meant."""
    from gsgen.cli.option_words import edit_meant

    name, *arguments = typed_words
    listing = "`gsgen --help` lists the commands."
    error = UnknownName.among("command", name, commands, listing=listing)
    word = for_shell(name)
    calls = calls_meant(name, arguments, group)
    edit = "" if group or calls not in ([], ["convert"]) else edit_meant(name, arguments)
    if edit:
        error.hint = f"Did you mean `{edit}`?"
    elif calls:
        texts = [_call_text(call, arguments) for call in calls]
        error.hint = f"Did you mean {' or '.join(texts)}?"
    elif advice := advice_on(name):
        error.hint = advice
    elif _RULE_ID.fullmatch(name.upper()):
        error.hint = f"Did you mean `gsgen explain {name.upper()}`?"
    elif os.path.exists(name) and group == "tiles":
        from gsgen.formats.tileset_paths import names_tileset

        call = "tiles info" if names_tileset(name) else "tiles build"
        error.hint = f"Did you mean {_call_text(call, typed_words)}?"
    elif os.path.exists(name):
        from gsgen.cli.output_hints import command_that_writes
        from gsgen.formats.inputs import training_folder

        is_model_path = name.endswith((".onnx", ".json")) or (
            os.path.isdir(name) and training_folder(Path(name)) is None
        )
        draw_hint = f"To draw it, type `gsgen render {word} -o picture.png`."
        error.hint = (
            f"To validate it, type `gsgen validate {word}`." if is_model_path else draw_hint
        )
        outputs = [entry for entry in arguments if not entry.startswith("-")]
        # Who types two files that are there means no output, which would be overwritten.
        is_output = "-o" in arguments or not all(map(os.path.exists, outputs))
        call = command_that_writes(Path(outputs[-1]), [name, *outputs[:-1]]) if outputs else ""
        if call and is_output:
            error.hint = f"Did you mean `{call}`?"
    return error


def _call_text(call: str, arguments: list[str]) -> str:
    words = [] if call.startswith("-") else arguments
    return f"`{shlex.join(['gsgen', *call.split(), *words])}`"
