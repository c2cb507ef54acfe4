"""Writes files under a temporary name, and renames them once they are complete."""

__all__ = [
    "MODEL_SUFFIX",
    "PAGE_SUFFIXES",
    "atomic_write",
    "is_device",
    "refuse_device",
    "refuse_folder",
    "refuse_itself",
    "refuse_missing_folder",
    "refuse_model",
    "require_new_folder",
    "require_page",
    "similar_file_hint",
    "write_fault",
]

import errno
import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from gsgen.contract._safe_text import for_shell
from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.drafts import temporary_folder

MODEL_SUFFIX = ".onnx"
"""The suffix of model files."""

PAGE_SUFFIXES = (".html", ".htm")
"""The suffixes of HTML pages."""


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path, and rename the file there to its final path after the block.

    Files beside it (external weights), also in subfolders, are moved first, so that a model never
    refers to a missing file. If the block raises, nothing is moved and the temporary files are
    removed.

    Raises:
        ConfigInvalid: ``path`` is a folder or a device, or cannot be written to, as on a full disk.
    """
    refuse_folder(path)
    refuse_device(path)
    with ExitStack() as stack:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            folder = stack.enter_context(temporary_folder(path.parent))
        except OSError as error:
            raise _not_written_error(path, error) from error
        draft = folder / path.name
        try:
            yield draft
        except BrokenPipeError:  # raised by printing, not by the file
            raise
        except OSError as error:
            if error.filename is not None and folder.name not in str(error.filename):
                raise  # raised by a file that the block reads
            raise _not_written_error(path, error) from error
        written_files = [file for file in folder.rglob("*") if not file.is_dir()]
        for file in sorted(written_files, key=lambda file: (file == draft, file)):
            target = path.parent / file.relative_to(folder)
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                file.replace(target)
            except OSError as error:
                raise _not_written_error(target, error) from error


def refuse_folder(path: Path, example: str = "model.onnx") -> None:
    """Raise if the output path is a folder; call this before any work is done.

    The hint names ``example`` in the folder, unless the folder's own name has a suffix.
    """
    if path.is_dir():
        name = path.name if path.suffix else example
        hint = f"Name a file in it, such as {path / name}."
        raise ConfigInvalid("is a folder, expected a file to write", where=str(path), hint=hint)


def refuse_missing_folder(path: Path) -> None:
    """Raise if the folder of an output path does not exist; call it before any work is done.

    Raises:
        ConfigInvalid: There is no such folder.
    """
    if not path.parent.exists():
        hint = f"Create it: mkdir -p {for_shell(str(path.parent))}"
        raise ConfigInvalid(
            "the output is in a folder that does not exist", where=str(path), hint=hint
        )


def is_device(path: Path) -> bool:
    """Return whether a path is a device, pipe or socket: neither a regular file nor a folder.

    /dev/stdout counts as a device even where the shell redirects it to a file: a rename would
    replace the name for every other process.
    """
    path_chain = (path, path.readlink()) if path.is_symlink() else (path,)
    if any(parent.parent.resolve().is_relative_to("/proc") for parent in path_chain):
        return True
    return path.exists() and not path.is_file() and not path.is_dir()


def refuse_device(path: Path) -> None:
    """Raise if the output path is a device or a pipe, which a rename would replace."""
    if is_device(path):
        message = "is a device or a pipe, expected a file to write"
        raise ConfigInvalid(message, where=str(path), hint="Name a file.")


def refuse_itself(path: Path, sources: Iterable[Path], hint: str = "Name another file.") -> None:
    """Raise if the output would overwrite one of the input files."""
    if any(_is_same_file(path, source) for source in sources):
        message = "is also an input file, which would be overwritten"
        raise ConfigInvalid(message, where=str(path), hint=hint)


def _is_same_file(path: Path, source: Path) -> bool:
    try:
        return path.samefile(source)
    except (OSError, ValueError):  # one is absent, or a text that is not the name of a file
        return False


def refuse_model(path: Path, models: Iterable[Path] = ()) -> None:
    """Raise if a non-model output (e.g. a report) would overwrite a model file.

    `-o drift.onnx` for a report usually means that the user expected a copy of the model.
    """
    refuse_itself(path, models)
    if path.suffix.lower() == MODEL_SUFFIX:
        hint = f"Name another file, such as {path.with_suffix('.txt')}."
        message = f"ends in {MODEL_SUFFIX}, but the output is not a model"
        raise ConfigInvalid(message, where=str(path), hint=hint)


def require_new_folder(folder: Path) -> None:
    """Raise unless a folder does not exist, or is empty.

    Raises:
        ConfigInvalid: It holds files, or is a file.
    """
    hint = "Name a folder that does not exist yet."
    if folder.exists() and not folder.is_dir():
        raise ConfigInvalid("is a file, expected a folder", where=str(folder), hint=hint)
    if folder.exists() and any(folder.iterdir()):
        raise ConfigInvalid("the output folder is not empty", where=str(folder), hint=hint)


def require_page(path: Path, sources: Iterable[Path] = ()) -> None:
    """Raise if a page's output path lacks the suffix of a page, or is a folder or an input file."""
    refuse_folder(path, "page.html")
    refuse_itself(path, sources)
    if path.suffix.lower() not in PAGE_SUFFIXES:
        actual = f"has the suffix {path.suffix}" if path.suffix else "has no suffix"
        hint = f"Name a page, such as {path.with_suffix(PAGE_SUFFIXES[0])}."
        raise ConfigInvalid(f"{actual}, expected .html or .htm", where=str(path), hint=hint)


def _not_written_error(path: Path, error: OSError) -> ConfigInvalid:
    return ConfigInvalid(f"cannot be written: {write_fault(error)}", where=str(path))


def write_fault(error: OSError) -> str:
    """Return the cause of a failed write in the system's words.

    For a file in the place of an output's folder, ``mkdir`` says that it exists.
    """
    if isinstance(error, FileExistsError):
        return os.strerror(errno.ENOTDIR)
    return error.strerror or str(error)


def similar_file_hint(path: str | os.PathLike[str]) -> str:
    """Return a hint with the file whose name is nearest to a missing one, or an empty text."""
    from difflib import get_close_matches  # imported on failure only: start-up time counts

    folder, name = os.path.split(path)
    with suppress(OSError):  # there is no such folder either
        close_matches = get_close_matches(name, os.listdir(folder or "."), n=1, cutoff=0.7)
        if close_matches and close_matches[0] != name:
            return f"Did you mean {os.path.join(folder, close_matches[0])!r}?"
    return ""
