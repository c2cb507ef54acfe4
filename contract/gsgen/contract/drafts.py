"""Put files in their place only when they are whole."""

__all__ = ["draft_of", "refuse_folder"]

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gsgen.contract.errors import GsgenError


@contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """Yield a path to write to; what stands there when the block ends well is moved to ``path``.

    Files written beside the draft (external weights), in folders of their own, too, move along,
    before the model that refers to them. If the block raises, nothing is moved and nothing is left
    behind.

    Raises:
        GsgenError: ``path`` is a folder, or its own cannot be written to.
    """
    refuse_folder(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise _unwritten(path, error) from error
    with folder as name:
        draft = Path(name) / path.name
        yield draft
        made = [file for file in Path(name).rglob("*") if not file.is_dir()]
        for file in sorted(made, key=lambda file: (file == draft, file)):
            target = path.parent / file.relative_to(name)
            try:
                target.parent.mkdir(parents=True, exist_ok=True)
                file.replace(target)
            except OSError as error:
                raise _unwritten(target, error) from error


def refuse_folder(path: Path) -> None:
    """Refuse a folder where a file is to be written, before any work is done for it.

    Raises:
        GsgenError: ``path`` is a folder.
    """
    if path.is_dir():
        mend = f"Name a file in it, such as {path / 'model.onnx'}."
        raise GsgenError("is a folder, wanted a file to write", where=str(path), mend=mend)


def _unwritten(path: Path, error: OSError) -> GsgenError:
    return GsgenError(f"cannot be written: {error.strerror}", where=str(path))
