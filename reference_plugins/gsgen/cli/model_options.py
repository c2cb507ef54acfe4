"""Options and helper functions that several commands of the SDK share."""

__all__ = [
    "DryRun",
    "ModelFile",
    "PrintJsonOption",
    "Sizes",
    "copy_of",
    "exit_at_error",
    "first_names",
    "sizes_of",
]  # fmt: skip

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from gsgen.cli.output import echo_error
from gsgen.cli.progress import clear
from gsgen.contract.errors import (
    ConfigInvalid,
    ExitCode,
    GsgenError,
    HostProcessFailed,
    ModelUnreadable,
)

PrintJsonOption = Annotated[bool, typer.Option("--json", help="Print as JSON.")]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Write nothing; list the changes.")]
ModelFile = Annotated[
    Path, typer.Argument(help="The ONNX file, or its address.", show_default=False)
]
Sizes = Annotated[
    list[str] | None,
    typer.Option(metavar="SYMBOL=SIZE", help="Size of an open dimension; repeatable."),
]


def copy_of(output: Path | None, *, dry_run: bool) -> Path | None:
    """Return the path of the changed model that a command writes; None for a dry run."""
    if dry_run:
        return None
    if output is None:
        message = "is missing, expected the path of the copy"
        hint = "Give -o OUT.onnx, or --dry-run to list the changes."
        raise ConfigInvalid(message, where="--output", hint=hint)
    return output


def sizes_of(entries: Iterable[str] | None) -> dict[str, int]:
    """Parse options ``--size SYMBOL=SIZE`` into a dict from symbolic dimension to size."""
    return dict(map(_parse_size, entries or ()))


def _parse_size(entry: str) -> tuple[str, int]:
    symbol, sign, size = entry.partition("=")
    if not sign or not (size.isascii() and size.isdigit() and int(size) > 0):
        raise ConfigInvalid(
            f"the value is {entry!r}, expected SYMBOL=SIZE, such as J=24", where="--size"
        )
    return symbol, int(size)


@contextmanager
def exit_at_error() -> Iterator[None]:
    """Print an error about a model, and exit with its code; raise errors of options and of the machine."""
    try:
        yield
    except (ConfigInvalid, HostProcessFailed):
        raise
    except GsgenError as error:
        clear()
        echo_error(error)
        code = ExitCode.UNREADABLE if isinstance(error, ModelUnreadable) else ExitCode.FAILURE
        raise typer.Exit(code) from error
    clear()


def first_names(names: Sequence[str], max_names: int) -> str:
    """Join the first names of a list, followed by the number of the remaining ones."""
    remainder = f" and {len(names) - max_names} more" if len(names) > max_names else ""
    return ", ".join(names[:max_names]) + remainder
