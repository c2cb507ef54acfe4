"""Assemble the commands of every installed room into one program."""

__all__ = ["build", "main"]

import errno
import gc
import sys
from contextlib import suppress
from importlib.metadata import version
from typing import Annotated, Any, Never

import typer
from typer.core import TyperGroup

from gsgen.contract._extensions import Command, escaped, find_commands
from gsgen.contract.errors import GsgenError, UnknownName
from gsgen.contract.process.interrupts import INTERRUPTED, ending_at_interrupts

_USAGE = 2
_INTERNAL = 3
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS)  # of a disk


def main() -> None:
    """Run the program on the process's arguments, and exit with the contract's codes."""
    try:
        with ending_at_interrupts() as interrupts:
            _run()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    except SystemExit:
        if interrupts.seen.is_set():  # a window's loop takes Ctrl-C as a wish to close
            sys.exit(INTERRUPTED)
        raise


def _run() -> None:
    gc.set_threshold(50_000)  # imports make many objects and hardly any garbage
    arguments = sys.argv[1:]
    commands = find_commands()
    if arguments[:1] == ["help"] and "help" not in commands:
        arguments = [*arguments[1:], "--help"]
    named = next((word for word in arguments if not word.startswith("-")), None)
    if named is not None and named not in commands:
        _fail(UnknownName.among("command", named, commands))
    wanted = [commands[named]] if named else list(commands.values())
    try:
        try:
            build(wanted)(arguments)
        finally:
            sys.stdout.flush()  # what cannot be written is told while somebody can
    except GsgenError as error:
        _fail(error)
    except BrokenPipeError:  # the reader of our output went away: `gsgen rules | head`
        sys.stderr.close()
        sys.exit(_USAGE)
    except OSError as error:
        if error.errno not in _FULL:
            _crash()
        _fail_unwritten(error)
    except Exception:  # a crash is neither a verdict nor a wrong option
        _crash()


def _fail_unwritten(error: OSError) -> Never:
    try:
        sys.stdout.flush()
    except OSError:
        with suppress(OSError):
            sys.stdout.close()  # or it would be tried again at the very end
    what = f"output, or a temporary file, cannot be written: {error.strerror}"
    hint = "Make room where it goes; the environment variable TMPDIR names another folder."
    _fail(GsgenError(what, where=str(error.filename or ""), hint=hint))


def _crash() -> Never:
    import traceback

    typer.echo(traceback.format_exc(), err=True)
    typer.echo("gsgen: internal error: this is a fault of gsgen, not yours", err=True)
    sys.exit(_INTERNAL)


def _fail(error: GsgenError) -> Never:
    typer.echo(f"gsgen: {error}", err=True)
    sys.exit(error.exit_code)


def build(commands: list[Command]) -> typer.Typer:
    """Return an app with ``commands``; only those are imported, so that start-up stays short."""
    app = typer.Typer(
        name="gsgen",
        cls=_Sorted,
        help="Export, validate and draw Gaussian Generators: ONNX models that emit 3D Gaussians.",
        epilog=_epilog(commands),
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_root)
    for command in commands:
        loaded = command.load()
        if isinstance(loaded, typer.Typer):
            app.add_typer(loaded, name=command.name)
        else:
            app.command(command.name, context_settings=command.context)(loaded)
    return app


class _Sorted(TyperGroup):
    """A group whose help lists its commands by name, groups among them."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return sorted(super().list_commands(ctx))


def _epilog(commands: list[Command]) -> str | None:
    missing = [command for command in commands if command.missing]
    if not missing:
        return None
    lines = [f"{one.name} needs {one.requirement}: {one.remedy}" for one in missing]
    return escaped("Not installed here: " + "; ".join(lines))


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"gsgen {version('gsgen')}")
        raise typer.Exit


def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            help="Show the version and exit.",
            callback=_show_version,
            is_eager=True,
        ),
    ] = False,
) -> None:
    pass
