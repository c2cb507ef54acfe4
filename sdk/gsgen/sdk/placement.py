"""Put files in their place only when they are whole."""

__all__ = ["draft_of"]

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gsgen.contract.errors import GsgenError


@contextmanager
def draft_of(path: Path) -> Iterator[Path]:
    """Yield a path to write to; what stands there when the block ends well is moved to ``path``.

    Files written beside the draft (external weights) move along, before the model that refers to
    them. If the block raises, nothing is moved and nothing is left behind.

    Raises:
        GsgenError: The folder cannot be written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        folder = tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise GsgenError(f"cannot be written: {error.strerror}", where=str(path)) from error
    with folder as name:
        draft = Path(name) / path.name
        yield draft
        for file in sorted(Path(name).iterdir(), key=lambda file: file == draft):
            file.replace(path.parent / file.name)
