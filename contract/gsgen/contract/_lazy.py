"""Lazy imports: a package loads each public name on first use, which keeps start-up fast."""

__all__ = ["lazy_getattr"]

import sys
from collections.abc import Callable, Mapping
from importlib import import_module


def lazy_getattr(package: str, home: Mapping[str, str]) -> Callable[[str], object]:
    """Return a module ``__getattr__`` (PEP 562) that imports the public names of ``package``.

    Args:
        package: The package's ``__name__``.
        home: Name → the submodule that defines it; a submodule that is itself public stands for
            itself.
    """

    def load(name: str) -> object:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        module = import_module(f"{package}.{home[name]}")
        is_submodule = home[name].rpartition(".")[2] == name
        value: object = module if is_submodule else getattr(module, name)
        setattr(sys.modules[package], name, value)
        return value

    return load
