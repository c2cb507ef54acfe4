"""Find what `gsgen export module:factory` names, and call it with what `--arg` gives."""

__all__ = ["Factory", "is_target", "load_factory"]

import importlib
import inspect
import sys
import typing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from gsgen.contract.errors import ConfigInvalid, GsgenError, UnknownName
from gsgen.sdk.exporting.source_lines import line_of
from gsgen.sdk.plugins.argument_values import convert, name_of

_VARIADIC = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


@dataclass(frozen=True, slots=True)
class Factory:
    """Something that gives a generator when it is called.

    Attributes:
        target: ``module:name``, as it was asked for.
        make: The class, function or finished generator.
    """

    target: str
    make: Any

    @property
    def parameters(self) -> dict[str, inspect.Parameter]:
        """What it takes; nothing if it is a finished generator."""
        if not _is_factory(self.make):
            return {}
        try:
            found = inspect.signature(self.make).parameters
        except ValueError:  # a class of an extension module has no signature
            return {}
        return dict(found)

    def arguments(self, entries: Sequence[str]) -> dict[str, Any]:
        """Return the keyword arguments that ``KEY=VALUE`` words mean, typed as declared.

        Raises:
            ConfigInvalid: A word is malformed, names nothing, or cannot be of the type declared.
        """
        made: dict[str, Any] = {}
        for entry in entries:
            key, sign, text = entry.partition("=")
            if not sign:
                hint = "Write it as --arg side=24."
                raise ConfigInvalid(f"{entry!r} has no '='", where="--arg", hint=hint)
            made[key] = convert(text, self._type_of(key), f"--arg {key}")
        missing = [one for one in self._needed() if one not in made]
        if missing:
            hint = " ".join(f"--arg {name}=…" for name in missing)
            what = f"{self.target} needs {', '.join(missing)}"
            raise ConfigInvalid(what, where="--arg", hint=f"Add {hint}")
        return made

    def build(self, arguments: dict[str, Any]) -> Any:
        """Call it and return a generator.

        Raises:
            GsgenError: It raised, or it returned something else.
        """
        if not _is_factory(self.make):
            return self.make
        try:
            made = self.make(**arguments)
        except GsgenError:
            raise
        except Exception as error:  # the user's code may raise anything
            raise _raised(error, self.target) from error
        return _checked(made, self.target)

    def _needed(self) -> Iterator[str]:
        for name, one in self.parameters.items():
            if one.default is one.empty and one.kind not in _VARIADIC:
                yield name

    def _type_of(self, key: str) -> Any:
        known = self.parameters
        variadic = [one for one in known.values() if one.kind == one.VAR_KEYWORD]
        named = {name for name, one in known.items() if one.kind not in _VARIADIC}
        if key not in named:
            if variadic and key.isidentifier():
                return str
            raise UnknownName.among("argument", key, named, f"--arg, {self.target}")
        hints = _hints(self.make)
        if key in hints:
            return hints[key]
        default = known[key].default
        return str if default in (known[key].empty, None) else type(default)


def _is_factory(value: Any) -> bool:
    """Say whether ``value`` is to be called; a finished module is callable, but not for that."""
    import torch

    return callable(value) and not isinstance(value, torch.nn.Module)


def _hints(make: Any) -> dict[str, Any]:
    function = make.__init__ if inspect.isclass(make) else make
    try:
        return typing.get_type_hints(function)
    except (
        NameError,
        TypeError,
        AttributeError,
    ):  # annotations that only a checker can read
        return {}


def is_target(word: str) -> bool:
    """Say whether ``word`` can only be meant as ``module:factory``."""
    return ":" in word and not word.startswith("-")


def load_factory(target: str, folder: Path | None = None) -> Factory:
    """Import what ``target`` names; modules of ``folder`` come first.

    Args:
        target: ``package.module:factory``, or ``file.py:factory``.
        folder: The current folder where absent.

    Raises:
        UnknownName: There is no such module, or nothing of that name in it.
        ConfigInvalid: It is not written so.
        GsgenError: The module raised while it was imported.
    """
    place = folder or Path.cwd()
    module_name, _, path = target.partition(":")
    if not module_name or not path:
        hint = "Write it as package.module:factory, such as wave_sheet:Wave."
        raise ConfigInvalid(f"{target!r} is no target", where="TARGET", hint=hint)
    if not module_name.endswith(".py") and (module_name[0] == "." or "/" in module_name):
        hint = f"Write {module_name}.py:{path}, or package.module:{path} with dots."
        raise ConfigInvalid(f"{module_name!r} is no module", where="TARGET", hint=hint)
    if module_name.endswith(".py"):
        file = (place / module_name).resolve()
        place, module_name = file.parent, file.stem
    module = _import(module_name, place)
    value: Any = module
    for name in path.split("."):
        if not hasattr(value, name):
            raise UnknownName.among("factory", name, _candidates(value), f"TARGET {target}")
        value = getattr(value, name)
    if _is_factory(value):
        return Factory(target, value)
    return Factory(target, _checked(value, target))


def _import(name: str, place: Path) -> Any:
    if str(place) not in sys.path:
        sys.path.insert(0, str(place))
    importlib.invalidate_caches()
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (
            name == error.name or name.startswith(f"{error.name}.")
        ):
            raise _no_module(name, error.name, place) from error
        raise _raised(error, name) from error
    except Exception as error:  # the user's code may raise anything
        raise _raised(error, name) from error


def _no_module(name: str, absent: str, place: Path) -> UnknownName:
    """Say which module of ``place`` may have been meant."""
    parent = place.joinpath(*absent.split(".")[:-1])
    prefix = absent.rpartition(".")[0]
    found = [path.stem for path in parent.glob("*.py") if path.stem != "__init__"]
    found += [path.name for path in parent.glob("*/") if path.name.isidentifier()]
    known = [f"{prefix}.{one}" if prefix else one for one in found]
    close = get_close_matches(absent, known, n=1, cutoff=0.5)
    hint = (
        f"Did you mean {close[0]!r}?"
        if close
        else f"Looked in {place} and in what is installed."
    )
    return UnknownName(f"unknown module {absent!r}", where=f"TARGET {name}", hint=hint)


def _candidates(holder: Any) -> list[str]:
    """Return what in a module gives generators, or may."""
    import torch

    own = getattr(holder, "__name__", None)
    return [
        name
        for name, value in vars(holder).items()
        if not name.startswith("_")
        and (isinstance(value, torch.nn.Module) or callable(value))
        and getattr(value, "__module__", own) == own
    ]


def _checked(made: Any, target: str) -> Any:
    """Return ``made`` if it is a generator."""
    import torch

    from gsgen.sdk.authoring.generator import GaussianGenerator
    from gsgen.sdk.authoring.module_checks import validate_module
    from gsgen.sdk.authoring.post_process import PostProcess
    from gsgen.sdk.errors import GeneratorInvalid

    if isinstance(made, GaussianGenerator | PostProcess):
        validate_module(made)
        return made
    hint = "Return an instance of a subclass of gsgen.sdk.GaussianGenerator."
    if isinstance(made, torch.nn.Module):
        hint = "Wrap it: gsgen.sdk.wrap(module, inputs=…, outputs=…)."
    what = f"gives {name_of(type(made))}, wanted a GaussianGenerator"
    raise GeneratorInvalid(what, where=target, hint=hint)


def _raised(error: Exception, where: str) -> GsgenError:
    """Say what the user's code raised, and in which of its lines."""
    said = error.msg if isinstance(error, SyntaxError) else str(error)
    line = line_of(error)
    place = f"{where}, {line}" if line else where
    return GsgenError(f"{type(error).__name__}: {said}", where=place)
