"""Runs the `gsgen` program: answers --version and --help from data, else runs one command."""

__all__ = ["main"]

import atexit
import errno
import gc
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Never, TextIO

from gsgen.cli.text_streams import accept_any_text, open_closed_streams, safe_streams
from gsgen.contract.errors import ExitCode, FileNote, GsgenError
from gsgen.contract.process.drafts import remove_own_drafts
from gsgen.contract.process.interrupts import end_on_interrupt

# Objects between two garbage collections: more than all imports of a command create.
_COLLECTION_THRESHOLD = 500_000
# Errors of a full or read-only disk, and of a closed stdout.
_UNWRITABLE_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EBADF)


def main() -> None:
    """Run the `gsgen` command line on the process's arguments, and exit with its exit code."""
    open_closed_streams()
    accept_any_text()
    with safe_streams():
        _run_until_interrupt()


def _run_until_interrupt() -> None:
    try:
        with end_on_interrupt() as interrupts:
            _run_command()
    except KeyboardInterrupt:
        sys.exit(interrupts.exit_code)
    except SystemExit as system_exit:
        if interrupts.requested.is_set():  # a window's event loop closes it on Ctrl-C
            sys.exit(interrupts.exit_code)
        if system_exit.code == ExitCode.INTERNAL and system_exit.__cause__ is not None:
            _report_early_end(system_exit)
        raise
    finally:
        remove_own_drafts()  # for a second Ctrl-C, which stops the removal after the first


def _run_command() -> None:
    gc.set_threshold(_COLLECTION_THRESHOLD)  # imports create many objects and hardly any garbage
    atexit.register(gc.freeze)  # so that the interpreter's last collection has nothing to visit
    arguments = sys.argv[1:]
    if arguments[:1] == ["help"]:
        arguments = [*arguments[1:], "--help"]
    try:
        try:
            with _notes_printed():
                _dispatch_command(arguments)
        finally:
            sys.stdout.flush()  # a failed write must be reported before the interpreter exits
    except GsgenError as error:
        _exit_with_error(error)
    except BrokenPipeError:
        _exit_at_closed_pipe()
    except OSError as error:
        _fail_at_system(error)
    except UnicodeEncodeError as error:
        _fail_unencodable_text(error)
    except SystemExit as system_exit:
        if isinstance(system_exit.__context__, BrokenPipeError):
            _exit_at_closed_pipe()  # click and rich would exit with 1, as if a model were invalid
        raise
    except KeyboardInterrupt:
        raise
    except BaseException:  # a crash is neither a verdict nor a wrong option
        _exit_after_crash()


@contextmanager
def _notes_printed() -> Iterator[None]:
    """Print each warning about an input file once, as a note, on standard error."""
    printed_texts: set[str] = set()
    with warnings.catch_warnings():
        warnings.simplefilter("always", FileNote)
        show_other = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if not issubclass(category, FileNote):
                show_other(message, category, filename, lineno, file, line)
            elif str(message) not in printed_texts:
                from gsgen.cli.output import echo

                printed_texts.add(str(message))
                echo(f"note: {message}", err=True)

        warnings.showwarning = show
        yield


def _dispatch_command(arguments: list[str]) -> None:
    """Answer from data where no command runs; else run the command that the arguments name."""
    if "_GSGEN_COMPLETE" not in os.environ:  # a shell does not ask for completions
        if arguments[:1] in (["--version"], ["-V"], ["-v"]):
            from gsgen import __version__

            print(f"gsgen {__version__}")
            return
        if not arguments or arguments[0] in ("-h", "--help"):
            from gsgen.cli.root_help import print_help

            print_help()
            sys.exit(ExitCode.SUCCESS if arguments else ExitCode.USAGE)
    from gsgen.cli.command_group import build

    build()(arguments, prog_name="gsgen")


def _exit_at_closed_pipe() -> Never:
    """End silently where the reader closed the pipe: `gsgen rules | head`."""
    sys.stderr.close()  # to which the interpreter would report that stdout cannot be flushed
    sys.exit(ExitCode.USAGE)


def _fail_at_system(error: OSError) -> Never:
    """Report what the system refuses: it is no fault of gsgen that a disk is full."""
    if error.errno in _UNWRITABLE_ERRORS:
        _fail_unwritable(error)
    if error.filename is not None:
        _exit_with_error(GsgenError(error.strerror or str(error), where=str(error.filename)))
    if error.errno == errno.ENOENT:  # of os.getcwd(), which names no file
        _exit_with_error(
            GsgenError("the current folder does not exist", hint="Change to another folder.")
        )
    _exit_after_crash()


def _fail_unencodable_text(error: UnicodeEncodeError) -> Never:
    """Report a file name whose bytes are not UTF-8, which libraries and formats cannot take."""
    text = error.object[error.start : error.end]
    if not all("\udc80" <= character <= "\udcff" for character in text):
        _exit_after_crash()
    _exit_with_error(
        GsgenError("the name is not valid UTF-8", where=error.object, hint="Rename the file.")
    )


def _fail_unwritable(error: OSError) -> Never:
    try:
        sys.stdout.flush()
    except OSError:
        with suppress(OSError):
            sys.stdout.close()  # else the interpreter flushes it again at exit
    message = f"output, or a temporary file, cannot be written: {error.strerror}"
    hint = "Make room where it goes; the environment variable TMPDIR names another folder."
    if error.errno == errno.EBADF:
        hint = "Standard output is closed."
    _exit_with_error(GsgenError(message, where=str(error.filename or ""), hint=hint))


def _exit_after_crash() -> Never:
    import traceback

    from gsgen.cli.progress import clear

    clear()
    message = "gsgen: internal error: this is a fault of gsgen, not yours"
    print(traceback.format_exc(), message, sep="\n", file=sys.stderr)
    sys.exit(ExitCode.INTERNAL)


def _report_early_end(system_exit: SystemExit) -> None:
    """Print which line of code, of a plugin for example, ended a command with SystemExit."""
    import traceback

    from gsgen.contract._entry_points import short_repr

    cause = system_exit.__cause__
    assert cause is not None
    frame = traceback.extract_tb(cause.__traceback__)[-1]
    where = f"{frame.filename}:{frame.lineno} ({frame.line})"
    print(f"gsgen: {short_repr(cause)} ended the command: {where}", file=sys.stderr)


def _exit_with_error(error: GsgenError) -> Never:
    from gsgen.cli.output import echo_error

    echo_error(error)
    sys.exit(error.exit_code)
