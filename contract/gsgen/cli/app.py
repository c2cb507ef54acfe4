"""Builds the `gsgen` program from the commands of all installed packages."""

__all__ = ["build", "main"]

import atexit
import errno
import gc
import os
import sys
from contextlib import suppress
from importlib.metadata import version
from typing import Annotated, Any, Never

import typer
from typer.core import TyperCommand, TyperGroup

from gsgen.cli.help_panels import arrange_options, panel_of, panel_order
from gsgen.cli.output_hints import output_hint
from gsgen.cli.text_streams import accept_any_text
from gsgen.contract._extensions import Command, escape_markup, find_commands
from gsgen.contract.commands.options import OPTION_ORDER
from gsgen.contract.commands.output import echo_error
from gsgen.contract.commands.progress import clear
from gsgen.contract.errors import ExitCode, GsgenError, UnknownName
from gsgen.contract.process.interrupts import ending_at_interrupts

# Objects between two garbage collections: more than all imports of a command create.
_COLLECT_AFTER = 500_000
# Errors of a full or read-only disk.
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)


def main() -> None:
    """Run the `gsgen` command line on the process's arguments, and exit with its exit code."""
    accept_any_text()
    try:
        with ending_at_interrupts() as interrupts:
            _run()
    except KeyboardInterrupt:
        sys.exit(ExitCode.INTERRUPTED)
    except SystemExit:
        if interrupts.requested.is_set():  # a window's event loop closes it on Ctrl-C
            sys.exit(ExitCode.INTERRUPTED)
        raise


def _run() -> None:
    gc.set_threshold(_COLLECT_AFTER)  # imports create many objects and hardly any garbage
    atexit.register(gc.freeze)  # so that the interpreter's last collection has nothing to visit
    arguments = sys.argv[1:]
    commands = find_commands()
    if arguments[:1] == ["help"] and "help" not in commands:
        arguments = [*arguments[1:], "--help"]
    command_name = next((word for word in arguments if not word.startswith("-")), None)
    if command_name is not None and command_name not in commands:
        _fail(_unknown_command(command_name, commands))
    selected = [commands[command_name]] if command_name else list(commands.values())
    if arguments == ["--version"]:
        selected = []  # loading them would take a quarter of a second
    try:
        try:
            program = typer.main.get_command(build(selected))
            arrange_options(program)
            program(arguments)
        finally:
            sys.stdout.flush()  # a failed write must be reported before the interpreter exits
    except GsgenError as error:
        _fail(error)
    except BrokenPipeError:  # the reader closed the pipe: `gsgen rules | head`
        sys.stderr.close()
        sys.exit(ExitCode.USAGE)
    except OSError as error:
        if error.errno not in _DISK_FULL:
            _crash()
        _fail_unwritten(error)
    except Exception:  # a crash is neither a verdict nor a wrong option
        _crash()


def _unknown_command(name: str, commands: dict[str, Command]) -> UnknownName:
    error = UnknownName.among("command", name, commands)
    if os.path.exists(name):
        is_checked = name.endswith((".onnx", ".json")) or os.path.isdir(name)
        to_draw = f"To draw the file, type `gsgen render {name} -o picture.png`."
        error.hint = f"To validate it, type `gsgen validate {name}`." if is_checked else to_draw
    return error


def _fail_unwritten(error: OSError) -> Never:
    try:
        sys.stdout.flush()
    except OSError:
        with suppress(OSError):
            sys.stdout.close()  # else the interpreter flushes it again at exit
    message = f"output, or a temporary file, cannot be written: {error.strerror}"
    hint = "Make room where it goes; the environment variable TMPDIR names another folder."
    _fail(GsgenError(message, where=str(error.filename or ""), hint=hint))


def _crash() -> Never:
    import traceback

    clear()
    typer.echo(traceback.format_exc(), err=True)
    typer.echo("gsgen: internal error: this is a fault of gsgen, not yours", err=True)
    sys.exit(ExitCode.INTERNAL)


def _fail(error: GsgenError) -> Never:
    echo_error(error)
    sys.exit(error.exit_code)


def build(commands: list[Command]) -> typer.Typer:
    """Return a typer app with only the commands needed, which keeps the program's start fast."""
    app = typer.Typer(
        name="gsgen",
        cls=_Sorted,
        help="Export, validate and draw Gaussian Generators: ONNX models that emit 3D Gaussians.",
        epilog=_epilog(commands),
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    for command in commands:
        loaded = command.load()
        if isinstance(loaded, typer.Typer):
            app.add_typer(loaded, name=command.name, rich_help_panel=panel_of(command.name))
        else:
            app.command(
                command.name,
                cls=_Ordered,
                context_settings=command.context,
                rich_help_panel=panel_of(command.name),
            )(loaded)
    return app


class _Ordered(TyperCommand):
    """A click command that records in which order the user typed its options."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse command-line arguments, and record parameter names in the order typed."""
        typed = list(args)
        values, _, order = self.make_parser(ctx).parse_args(args=list(args))
        ctx.meta[OPTION_ORDER] = [parameter.name for parameter in order]
        try:
            return super().parse_args(ctx, args)
        except typer.BadParameter as error:
            bounds = getattr(error.param, "type", None)
            if "not a valid" in error.message and isinstance(getattr(bounds, "name", None), str):
                error.message += _number_hint(bounds)
            if not error.message and getattr(error.param, "name", None) == "output":
                error.message = output_hint(self.name or "", typed, values)
            error.param = self._missing_argument(error.param, values)
            raise

    def _missing_argument(self, missing: Any, values: dict[str, Any]) -> Any:
        """Return the parameter that the user left out, for the one that click misses.

        A single value of ``SOURCE… TARGET`` is the last argument to click, and SOURCE to the user.
        """
        arguments = [item for item in self.params if item.param_type_name == "argument"]
        if missing not in arguments[:-1] or values[missing.name or ""]:
            return missing
        last = arguments[-1]
        return last if missing.nargs == -1 and values[last.name or ""] else missing


def _number_hint(bounds: Any) -> str:
    """Return the type and the range of a numeric command-line option; empty for others."""
    noun = {"int": "a whole number", "float": "a number"}.get(bounds.name.split()[0])
    if noun is None:
        return ""
    least, most = getattr(bounds, "min", None), getattr(bounds, "max", None)
    above = "" if least is None else f" from {least:g}"
    return f" Give {noun}{above}{'' if most is None else f' to {most:g}'}."


class _Sorted(TyperGroup):
    """A click command group whose help lists its commands under headings (panels)."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands, in the order of the help."""
        return sorted(super().list_commands(ctx), key=panel_order)


def _epilog(commands: list[Command]) -> str | None:
    missing: dict[str, list[str]] = {}
    for command in commands:
        if command.missing:
            missing.setdefault(command.remedy, []).append(command.name)
    lines = [f"{', '.join(names)}: {remedy}" for remedy, names in missing.items()]
    return escape_markup("Not installed here: " + "; ".join(lines)) if lines else None


def _show_version(requested: bool) -> None:
    if requested:
        typer.echo(f"gsgen {version('gsgen')}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", help="Show the version and exit.", callback=_show_version, is_eager=True
        ),
    ] = False,
) -> None:
    pass
