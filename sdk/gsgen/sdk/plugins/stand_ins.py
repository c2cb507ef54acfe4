"""Stands in for modules that cannot be installed, such as extensions of CUDA, while others import them."""

__all__ = ["StandInCalled", "stand_ins"]

import importlib
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

from gsgen.contract.errors import ConfigInvalid, GsgenError


class StandInCalled(GsgenError):
    """Raised if a module calls something of a package that a stand-in replaces."""


@contextmanager
def stand_ins(names: Sequence[str]) -> Iterator[None]:
    """Let imports of some packages, and of all their modules, give stand-ins.

    Every name of a stand-in is a class that can be imported, annotated with and derived from. To
    make an instance of it, or to call it as a function, raises :class:`StandInCalled`.

    Args:
        names: The packages, such as ``diff_gaussian_rasterization``.
    """
    for name in names:
        if not all(part.isidentifier() for part in name.split(".")):
            hint = "Give names of modules, such as simple_knn."
            raise ConfigInvalid(f"{name!r} is not the name of a module", where="--stub", hint=hint)
    finder = _StandInFinder(tuple(names))
    hidden = {name: module for name, module in sys.modules.items() if finder.replaces(name)}
    for name in hidden:
        del sys.modules[name]
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        for name in [name for name in sys.modules if finder.replaces(name)]:
            del sys.modules[name]
        sys.modules.update(hidden)
        importlib.invalidate_caches()


class _StandInFinder(MetaPathFinder, Loader):
    """Finds the modules of some packages, and makes stand-ins of them."""

    def __init__(self, packages: Sequence[str]) -> None:
        self._packages = packages

    def replaces(self, name: str) -> bool:
        """Return whether a module is one of the packages, or lies in one."""
        return any(name == package or name.startswith(f"{package}.") for package in self._packages)

    def find_spec(self, fullname: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """Return the specification of a module to stand in for; None for any other."""
        is_replaced = self.replaces(fullname)
        return ModuleSpec(fullname, self, is_package=True) if is_replaced else None

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Return an empty module, whose names are made when they are asked for."""
        return _StandInModule(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        """Run nothing: a stand-in has no code."""


class _StandInModule(ModuleType):
    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        value = _StandInType(name, (), {"__module__": self.__name__})
        setattr(self, name, value)
        return value


class _StandInType(type):
    """The type of the names of a stand-in: classes of which no instance can be made."""

    def __call__(cls, *_: Any, **__: Any) -> Any:
        where = f"{cls.__module__}.{cls.__qualname__}"
        raise StandInCalled(
            "was called, but a stand-in of --stub has no code",
            where=where,
            hint="Leave its call out of the factory and of forward, or install it.",
        )

    def __getattr__(cls, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        value = _StandInType(name, (), {"__module__": f"{cls.__module__}.{cls.__name__}"})
        setattr(cls, name, value)
        return value
