"""Put files in their place only when they are whole."""

__all__ = [
    "atomic_write",
    "is_device",
    "refuse_device",
    "refuse_folder",
    "refuse_itself",
    "refuse_model",
]

import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gsgen.contract.errors import ConfigInvalid

_MODEL = ".onnx"


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a path to write to; what stands there when the block ends well is moved to ``path``.

    Files written beside the draft (external weights), in folders of their own, too, move along,
    before the model that refers to them. If the block raises, nothing is moved and nothing is left
    behind.

    Raises:
        ConfigInvalid: ``path`` is a folder or a device, or cannot be written to, as on a full disk.
    """
    refuse_folder(path)
    refuse_device(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise _unwritten(path, error) from error
    with folder as name:
        draft = Path(name) / path.name
        try:
            yield draft
        except BrokenPipeError:  # of what is printed meanwhile
            raise
        except OSError as error:
            if error.filename is not None and name not in str(error.filename):
                raise  # of a file that is read
            raise _unwritten(path, error) from error
        written_files = [file for file in Path(name).rglob("*") if not file.is_dir()]
        for file in sorted(written_files, key=lambda file: (file == draft, file)):
            target = path.parent / file.relative_to(name)
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                file.replace(target)
            except OSError as error:
                raise _unwritten(target, error) from error


def refuse_folder(path: Path) -> None:
    """Refuse a folder where a file is to be written, before any work is done for it.

    Raises:
        ConfigInvalid: ``path`` is a folder.
    """
    if path.is_dir():
        name = path.name if path.suffix else "model.onnx"
        hint = f"Name a file in it, such as {path / name}."
        raise ConfigInvalid(
            "is a folder, wanted a file to write", where=str(path), hint=hint
        )


def is_device(path: Path) -> bool:
    """Say whether something stands there that is neither a file nor a folder.

    /dev/stdout is such a name even where a shell has made a file of it: whoever moves another
    file there takes the name away from all others.
    """
    way = (path, path.readlink()) if path.is_symlink() else (path,)
    if any(parent.parent.resolve().is_relative_to("/proc") for parent in way):
        return True
    return path.exists() and not path.is_file() and not path.is_dir()


def refuse_device(path: Path) -> None:
    """Refuse a device or a pipe: whole files are moved to their place, and would take its own.

    Raises:
        ConfigInvalid: ``path`` is one.
    """
    if is_device(path):
        message = "is a device or a pipe, wanted a file to write"
        raise ConfigInvalid(message, where=str(path), hint="Name a file.")


def refuse_itself(
    path: Path, sources: Iterable[Path], hint: str = "Name another file."
) -> None:
    """Refuse to write over what is read, by whatever name, before any work is done.

    Raises:
        ConfigInvalid: ``path`` is one of ``sources``, which would be lost.
    """
    if path.exists() and any(
        source.exists() and path.samefile(source) for source in sources
    ):
        message = "is the file that is read, and would be lost"
        raise ConfigInvalid(message, where=str(path), hint=hint)


def refuse_model(path: Path, models: Iterable[Path] = ()) -> None:
    """Refuse a model's place for what is none, a report for example, before any work is done.

    Whoever writes `-o drift.onnx` for a report took the option for that of a copy, and would
    lose the model.

    Args:
        path: Where something is to be written.
        models: What is read, by whatever names.

    Raises:
        ConfigInvalid: ``path`` is one of the models, or ends as models do.
    """
    refuse_itself(path, models)
    if path.suffix.lower() == _MODEL:
        hint = f"Name another file, such as {path.with_suffix('.txt')}."
        message = f"ends in {_MODEL}, and what is written there is no model"
        raise ConfigInvalid(message, where=str(path), hint=hint)


def _unwritten(path: Path, error: OSError) -> ConfigInvalid:
    return ConfigInvalid(f"cannot be written: {error.strerror or error}", where=str(path))
