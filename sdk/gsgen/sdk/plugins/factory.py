"""Imports the user's factory of `gsgen export module:factory`, and calls it with `--arg`."""

__all__ = ["Factory", "is_target", "load_factory", "locate_errors", "require_torch"]

import importlib
import inspect
import sys
import typing
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gsgen.contract._entry_points import plugin_exits_as_errors
from gsgen.contract.errors import ConfigInvalid, GsgenError, UnknownName
from gsgen.sdk.exporting.tracing.source_lines import user_line_of
from gsgen.sdk.plugins.argument_values import convert, name_of

_VARIADIC_PARAMETER_KINDS = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


@dataclass(frozen=True, slots=True)
class Factory:
    """A user's callable that returns a Gaussian Generator module of torch, or such a module itself."""

    target: str  # ``module:name``, as the user typed it
    make: Any  # the class, function or finished generator

    @property
    def parameters(self) -> dict[str, inspect.Parameter]:
        """The parameters of a user's factory function; empty for a finished torch generator."""
        if not _is_factory(self.make):
            return {}
        try:
            parameters = inspect.signature(self.make).parameters
        except ValueError:  # a class of an extension module has no signature
            return {}
        return dict(parameters)

    def arguments(self, entries: Sequence[str]) -> dict[str, Any]:
        """Convert ``KEY=VALUE`` options to keyword arguments of the factory's declared types."""
        values: dict[str, Any] = {}
        for entry in entries:
            key, sign, text = entry.partition("=")
            if not sign:
                hint = "Write it as --arg side=24."
                raise ConfigInvalid(
                    f"{entry!r} has no '=', expected KEY=VALUE", where="--arg", hint=hint
                )
            values[key] = convert(text, self._type_of_argument(key), f"--arg {key}")
        missing = [name for name in self._required_names() if name not in values]
        if missing:
            hint = " ".join(f"--arg {name}=…" for name in missing)
            message = f"{self.target} needs {', '.join(missing)}"
            raise ConfigInvalid(message, where="--arg", hint=f"Add {hint}")
        return values

    def build(self, arguments: dict[str, Any]) -> Any:
        """Call a user's factory function and return the torch generator that it builds."""
        if not _is_factory(self.make):
            return self.make
        build = locate_errors(partial(self.make, **arguments), self.target)
        return _require_generator(build(), self.target)

    def _required_names(self) -> Iterator[str]:
        for name, parameter in self.parameters.items():
            if (
                parameter.default is parameter.empty
                and parameter.kind not in _VARIADIC_PARAMETER_KINDS
            ):
                yield name

    def _type_of_argument(self, key: str) -> Any:
        known = self.parameters
        variadic_parameters = [
            parameter for parameter in known.values() if parameter.kind == parameter.VAR_KEYWORD
        ]
        names = {
            name
            for name, parameter in known.items()
            if parameter.kind not in _VARIADIC_PARAMETER_KINDS
        }
        if key not in names:
            if variadic_parameters and key.isidentifier():
                return str
            raise UnknownName.among("argument", key, names, f"--arg, {self.target}")
        hints = _type_hints_of(self.make)
        if key in hints:
            return hints[key]
        default = known[key].default
        return str if default in (known[key].empty, None) else type(default)


def _is_factory(value: Any) -> bool:
    """Return whether the argument TARGET names a factory function, not a finished module."""
    import torch

    return callable(value) and not isinstance(value, torch.nn.Module)


def _type_hints_of(make: Any) -> dict[str, Any]:
    function = make.__init__ if inspect.isclass(make) else make
    try:
        return typing.get_type_hints(function)
    except (NameError, TypeError, AttributeError):  # annotations that only a checker can read
        return {}


def is_target(word: str) -> bool:
    """Return whether a command-line argument has the form ``module:factory``."""
    return ":" in word and not word.startswith("-")


def require_torch() -> None:
    """Raise if torch is not installed."""
    if find_spec("torch") is None:
        message = "`gsgen export` needs torch, which is not installed"
        raise GsgenError(message, hint="pip install 'gsgen[sdk]'")


def load_factory(target: str, folder: Path | None = None) -> Factory:
    """Import a user's factory ``module:name``; the given folder is searched first.

    ``target`` is ``package.module:factory`` or ``file.py:factory``.
    """
    require_torch()
    search_folder = folder or Path.cwd()
    module_name, _, path = target.partition(":")
    if not module_name or not path:
        hint = "Write it as package.module:factory, such as wave_sheet:Wave."
        raise ConfigInvalid(f"{target!r} names no module and function", where="TARGET", hint=hint)
    if not module_name.endswith(".py") and (module_name[0] == "." or "/" in module_name):
        hint = f"Write {module_name}.py:{path}, or package.module:{path} with dots."
        message = f"{module_name!r} is not the name of a module"
        raise ConfigInvalid(message, where="TARGET", hint=hint)
    if module_name.endswith(".py"):
        file = (search_folder / module_name).resolve()
        search_folder, module_name = file.parent, file.stem
    module = _import_module_from(module_name, search_folder)
    value: Any = module
    for name in path.split("."):
        if not hasattr(value, name):
            raise UnknownName.among("factory", name, _generator_names(value), f"TARGET {target}")
        value = getattr(value, name)
    if _is_factory(value):
        return Factory(target, value)
    return Factory(target, _require_generator(value, target))


def _import_module_from(name: str, search_folder: Path) -> Any:
    if str(search_folder) not in sys.path:
        sys.path.insert(0, str(search_folder))
    importlib.invalidate_caches()
    try:
        with plugin_exits_as_errors():
            return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(f"{error.name}.")):
            raise _missing_module_error(name, error.name, search_folder) from error
        raise _factory_error(error, name) from error
    except Exception as error:  # the user's code may raise anything
        raise _factory_error(error, name) from error


def _missing_module_error(name: str, missing_module: str, search_folder: Path) -> UnknownName:
    """Return the error for a module that cannot be found, with a similar file name as a hint."""
    parent = search_folder.joinpath(*missing_module.split(".")[:-1])
    prefix = missing_module.rpartition(".")[0]
    module_stems = [path.stem for path in parent.glob("*.py") if path.stem != "__init__"]
    module_stems += [path.name for path in parent.glob("*/") if path.name.isidentifier()]
    known = [f"{prefix}.{stem}" if prefix else stem for stem in module_stems]
    close = get_close_matches(missing_module, known, n=1, cutoff=0.5)
    hint = (
        f"Did you mean {close[0]!r}?"
        if close
        else f"Searched {search_folder} and the installed packages."
    )
    return UnknownName(f"unknown module {missing_module!r}", where=f"TARGET {name}", hint=hint)


def _generator_names(namespace: Any) -> list[str]:
    """Return the names of torch generators in a Python module, and of functions returning one."""
    import torch

    module_name = getattr(namespace, "__name__", None)
    return [
        name
        for name, value in vars(namespace).items()
        if not name.startswith("_")
        and (isinstance(value, torch.nn.Module) or callable(value))
        and getattr(value, "__module__", module_name) == module_name
    ]


def _require_generator(module: Any, target: str) -> Any:
    """Return a module that is a torch generator or post-process model; raise for others."""
    import torch

    from gsgen.sdk.authoring.generator import GaussianGenerator
    from gsgen.sdk.authoring.module_checks import WRAP_CALL, validate_module
    from gsgen.sdk.authoring.post_process import PostProcess
    from gsgen.sdk.errors import GeneratorInvalid

    if isinstance(module, GaussianGenerator | PostProcess):
        is_generator = isinstance(module, GaussianGenerator)
        validate_module(module, GaussianGenerator if is_generator else PostProcess)
        return module
    hint = "Return an instance of a subclass of gsgen.sdk.GaussianGenerator."
    if isinstance(module, torch.nn.Module):
        hint = f"Write a function that returns {WRAP_CALL}, and export that."
    message = f"returns {name_of(type(module))}, expected a GaussianGenerator"
    raise GeneratorInvalid(message, where=target, hint=hint)


def locate_errors(build: Callable[[], Any], where: str) -> Callable[[], Any]:
    """Return a user's or a plugin's ``build`` whose errors name ``where`` and the line of its code."""

    def located_build() -> Any:
        try:
            with plugin_exits_as_errors():
                return build()
        except GsgenError:
            raise
        except Exception as error:  # that code may raise anything
            if isinstance(error, ModuleNotFoundError):
                require_torch()
            raise _factory_error(error, where) from error

    return located_build


def _factory_error(error: Exception, where: str) -> GsgenError:
    """Return an error for an exception in the user's code, with the line that raised it."""
    from gsgen.sdk.authoring.misspelled_names import misspelling_hint

    reason = error.msg if isinstance(error, SyntaxError) else str(error)
    line = user_line_of(error)
    location = f"{where}, {line}" if line else where
    hint = misspelling_hint(error)
    if isinstance(error, ModuleNotFoundError) and error.name:
        package = error.name.partition(".")[0]
        hint = f"Install {package}; or add --stub {package} if nothing calls it."
    return GsgenError(f"{type(error).__name__}: {reason}", where=location, hint=hint)
