"""Lazy imports: a package loads each public name on first use, which keeps start-up fast."""

__all__ = ["lazy_dir", "lazy_getattr"]

import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module


def lazy_getattr(package: str) -> Callable[[str], object]:
    """Return a module ``__getattr__`` (PEP 562) that imports the public names of ``package``.

    The modules of the names are those that the package's source imports them from under
    ``if TYPE_CHECKING:``, so that no second list has to agree with these imports.
    """

    def load(name: str) -> object:
        if name not in vars(sys.modules[package])["__all__"]:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = import_module(_home(package)[name])
        is_member = name in vars(home)  # else a submodule, which is itself public
        value: object = (
            getattr(home, name) if is_member else import_module(f"{home.__name__}.{name}")
        )
        setattr(sys.modules[package], name, value)
        return value

    return load


def lazy_dir(package: str) -> Callable[[], list[str]]:
    """Return a module ``__dir__`` that lists the public names of ``package``, loaded or not."""
    return lambda: sorted(vars(sys.modules[package])["__all__"])


@cache
def _home(package: str) -> dict[str, str]:
    """Return for each public name of a package the module that defines the name."""
    import ast
    import inspect

    tree = ast.parse(inspect.getsource(sys.modules[package]))
    return {
        alias.name: node.module
        for block in tree.body
        if isinstance(block, ast.If)
        for node in block.body
        if isinstance(node, ast.ImportFrom) and node.module
        for alias in node.names
    }
