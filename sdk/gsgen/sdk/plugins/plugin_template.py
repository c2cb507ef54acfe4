"""Writes the package of a new plugin from a template, with an example method and tests."""

__all__ = ["PluginPackage", "write_plugin_package"]

import keyword
import os
import re
import sys
import unicodedata
from dataclasses import dataclass
from importlib.metadata import metadata, version
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path

from gsgen.contract.errors import ConfigInvalid
from gsgen.contract.process.drafts import temporary_folder
from gsgen.sdk.plugins.plugin import find_plugins

_NAME_PATTERN = re.compile(r"[a-z][a-z0-9]*(-[a-z0-9]+)*")

# Template → path in the package; @package@ stands for the import name.
_TEMPLATE_FILES = {
    "pyproject.toml.in": "pyproject.toml",
    "README.md.in": "README.md",
    "gitignore.in": ".gitignore",
    "workflow.yml.in": ".github/workflows/test.yml",
    "init.py.in": "src/@package@/__init__.py",
    "checkpoint.py.in": "src/@package@/checkpoint.py",
    "example.py.in": "src/@package@/example.py",
    "generator.py.in": "src/@package@/generator.py",
    "plugin.py.in": "src/@package@/plugin.py",
    "conftest.py.in": "tests/conftest.py",
    "test_generator.py.in": "tests/test_generator.py",
    "test_conformance.py.in": "tests/test_conformance.py",
}


@dataclass(frozen=True, slots=True)
class PluginPackage:
    """Paths and names of a plugin package that was written from the template."""

    folder: Path  # the folder of the package
    package: str  # its import name
    files: tuple[Path, ...]  # all files, relative to the folder, sorted


def write_plugin_package(name: str, parent_folder: Path) -> PluginPackage:
    """Write the package of a new plugin into a new folder named like the package."""
    _check_name(name)
    folder, package = parent_folder / name, name.replace("-", "_")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        hint = "Choose another name, or another folder with --into."
        raise ConfigInvalid("the folder exists already", where=str(folder), hint=hint)
    replacements = {
        "name": name,
        "package": package,
        "class": "".join(part.capitalize() for part in name.split("-")),
        "title": name.replace("-", " ").capitalize(),
        "gsgen": version("gsgen"),
        "repository": _repository_url(),
    }
    texts = {
        _fill_template(where, replacements): _filled_plugin_template(source, replacements)
        for source, where in _TEMPLATE_FILES.items()
    }
    try:
        _write(folder, texts)
    except OSError as error:
        raise ConfigInvalid(f"cannot be written: {error.strerror}", where=str(folder)) from error
    return PluginPackage(folder, package, tuple(Path(where) for where in sorted(texts)))


def _repository_url() -> str:
    """Return the address of gsgen's repository, from the metadata of the installed package."""
    labels = (str(entry).split(", ", 1) for entry in metadata("gsgen").get_all("Project-URL", []))
    return dict(labels)["Repository"]


def _check_name(name: str) -> None:
    if not _NAME_PATTERN.fullmatch(name):
        ascii_name = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
        suggestion = re.sub("[^a-z0-9]+", "-", ascii_name.lower()).strip("-0123456789")
        example = suggestion if _NAME_PATTERN.fullmatch(suggestion) else "my-method"
        hint = f"For example {example!r}."
        message = (
            f"{name!r} has other characters than lower-case letters, digits and single hyphens"
        )
        raise ConfigInvalid(message, where="NAME", hint=hint)
    package = name.replace("-", "_")
    conflict = ""
    if keyword.iskeyword(package) or keyword.issoftkeyword(package):
        conflict = "a keyword of Python"
    elif package in sys.stdlib_module_names or find_spec(package) is not None:
        conflict = "a module that can be imported already"
    elif name in find_plugins():
        conflict = "a plugin that is installed"
    if conflict:
        hint = f"For example 'my-{name}'."
        raise ConfigInvalid(f"the plugin name {name!r} is {conflict}", where="NAME", hint=hint)


def _filled_plugin_template(source: str, replacements: dict[str, str]) -> str:
    text = files("gsgen.sdk").joinpath("templates", "plugin", source).read_text("utf-8")
    return _fill_template(text, replacements)


def _fill_template(text: str, replacements: dict[str, str]) -> str:
    """Replace every @word@ in a template text; an unknown word raises KeyError."""
    return re.sub("@([a-z]+)@", lambda match: replacements[match[1]], text)


def _write(folder: Path, texts: dict[str, str]) -> None:
    """Write all files of a package into a temporary folder, and rename it when complete."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with temporary_folder(folder.parent) as draft:
        for where, text in texts.items():
            path = draft / where
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
        draft.chmod(0o777 & ~_process_umask())
        draft.replace(folder)


def _process_umask() -> int:
    """Return the process's file mode creation mask (umask)."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
