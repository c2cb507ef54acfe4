"""Write the package of a plugin: everything that a method needs to be exported, with its tests."""

__all__ = ["Scaffold", "scaffold"]

import keyword
import os
import re
import shutil
import sys
import tempfile
import unicodedata
from dataclasses import dataclass
from importlib.metadata import version
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from gsgen.contract.errors import ConfigInvalid
from gsgen.sdk.plugins.plugin import find_plugins

_NAME = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")

# Template → where it goes; @package@ stands for the import name.
_FILES = {
    "pyproject.toml.in": "pyproject.toml",
    "README.md.in": "README.md",
    "gitignore.in": ".gitignore",
    "workflow.yml.in": ".github/workflows/test.yml",
    "init.py.in": "src/@package@/__init__.py",
    "checkpoint.py.in": "src/@package@/checkpoint.py",
    "generator.py.in": "src/@package@/generator.py",
    "plugin.py.in": "src/@package@/plugin.py",
    "conftest.py.in": "tests/conftest.py",
    "test_generator.py.in": "tests/test_generator.py",
    "test_conformance.py.in": "tests/test_conformance.py",
}


@dataclass(frozen=True, slots=True)
class Scaffold:
    """A package that was written.

    Attributes:
        folder: Where it lies.
        package: What Python imports.
        files: All files, relative to the folder, in the order of a listing.
    """

    folder: Path
    package: str
    files: tuple[Path, ...]


def scaffold(name: str, into: Path) -> Scaffold:
    """Write the package ``name`` into a folder of that name in ``into``.

    Raises:
        ConfigInvalid: The name cannot be used, something stands there already, or the folder
            cannot be written.
    """
    _check_name(name)
    folder, package = into / name, name.replace("-", "_")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        hint = "Choose another name, or another folder with --into."
        raise ConfigInvalid("stands there already", where=str(folder), hint=hint)
    words = {
        "name": name,
        "package": package,
        "class": "".join(part.capitalize() for part in name.split("-")),
        "title": name.replace("-", " ").capitalize(),
        "gsgen": version("gsgen"),
    }
    made = {
        _filled(where, words): _template(source, words) for source, where in _FILES.items()
    }
    try:
        _write(folder, made)
    except OSError as error:
        raise ConfigInvalid(
            f"cannot be written: {error.strerror}", where=str(folder)
        ) from error
    return Scaffold(folder, package, tuple(Path(where) for where in sorted(made)))


def _check_name(name: str) -> None:
    if not _NAME.fullmatch(name):
        plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
        like = re.sub("[^a-z0-9]+", "-", plain.lower()).strip("-0123456789")
        hint = f"Such as {like!r}." if _NAME.fullmatch(like) else "Such as 'my-method'."
        what = f"{name!r} is not of lower-case letters, digits and single hyphens"
        raise ConfigInvalid(what, where="NAME", hint=hint)
    package = name.replace("-", "_")
    taken = ""
    if keyword.iskeyword(package) or keyword.issoftkeyword(package):
        taken = "a keyword of Python"
    elif package in sys.stdlib_module_names or find_spec(package) is not None:
        taken = "a module that can be imported already"
    elif name in find_plugins():
        taken = "a plugin that is installed"
    if taken:
        hint = f"Such as 'my-{name}'."
        raise ConfigInvalid(f"{name!r} is {taken}", where="NAME", hint=hint)


def _template(source: str, words: dict[str, str]) -> str:
    text = files("gsgen.sdk").joinpath("templates", "plugin", source).read_text("utf-8")
    return _filled(text, words)


def _filled(text: str, words: dict[str, str]) -> str:
    """Return ``text`` with every @word@ replaced; one that is not known is a fault of ours."""
    return re.sub("@([a-z]+)@", lambda match: words[match[1]], text)


def _write(folder: Path, made: dict[str, str]) -> None:
    """Write all files into a folder beside the place, and move it there when it is whole."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        for where, text in made.items():
            path = draft / where
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
        draft.chmod(0o777 & ~_umask())
        draft.replace(folder)
    except OSError:
        shutil.rmtree(draft, ignore_errors=True)
        raise


def _umask() -> int:
    """Return the process's mask, which can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
