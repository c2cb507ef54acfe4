"""Expands the file names of a command line: files, folders and globs."""

__all__ = ["expand_paths"]

import glob
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.atomic_files import MODEL_SUFFIX

_WILDCARDS = frozenset("*?[")


def expand_paths(
    names: Iterable[Path], is_one: Callable[[Path], bool] = lambda folder: False
) -> list[Path]:
    """Return the model files that names, folders and globs denote, each once, in order.

    A folder gives the models in it and below, sorted by path, without hidden files and folders. A
    folder for which ``is_one`` returns True, such as that of a tileset, stays one entry. A name with wildcards that no file has by itself is a glob, in which ``**`` matches any folders.

    Raises:
        ConfigInvalid: A folder holds no model, or a glob matches no file.
    """
    return list(dict.fromkeys(path for name in names for path in _expand(name, is_one)))


def _expand(name: Path, is_one: Callable[[Path], bool]) -> Iterator[Path]:
    if not name.is_dir() and not name.exists() and _WILDCARDS & set(str(name)):
        matches = sorted(glob.glob(str(name), recursive=True))
        if not matches:
            hint = "Check the folder that the command runs in."
            raise ConfigInvalid("the pattern matches no file", where=str(name), hint=hint)
        for match in matches:
            yield from _expand(Path(match), is_one)
    elif name.is_dir() and not is_one(name):
        models = sorted(path for path in name.rglob(f"*{MODEL_SUFFIX}") if _is_visible(path, name))
        if not models:
            hint = f"Name a folder with {MODEL_SUFFIX} files, or a file."
            raise ConfigInvalid("the folder holds no ONNX model", where=str(name), hint=hint)
        yield from models
    else:
        yield name


def _is_visible(path: Path, folder: Path) -> bool:
    hidden = any(part.startswith(".") for part in path.relative_to(folder).parts)
    return path.is_file() and not hidden
