"""Changes functions of imported modules in place, which spares a mutant the import of all modules."""

import gc
from collections import defaultdict
from collections.abc import Iterator
from inspect import CO_OPTIMIZED
from types import CodeType, FunctionType

Functions = dict[tuple[str, str, int], list[FunctionType]]
"""Live functions by file, qualified name and first line."""


def index_functions(root: str) -> Functions:
    """Return all live functions whose code lies below the folder ``root``."""
    functions: Functions = defaultdict(list)
    for value in gc.get_objects():
        # Not isinstance: it asks weak proxies of dead objects for their class.
        if type(value) is FunctionType and value.__code__.co_filename.startswith(root):
            functions[_key(value.__code__)].append(value)
    return functions


def _key(code: CodeType) -> tuple[str, str, int]:
    return code.co_filename, code.co_qualname, code.co_firstlineno


def changed_functions(before: str, after: str, file: str) -> list[tuple[CodeType, CodeType]] | None:
    """Return the outermost functions that differ between two texts of a module.

    Returns:
        Pairs of old and new code; None if code differs that runs at import, such as constants,
        decorators and the bodies of classes, or if a text does not compile.
    """
    try:
        return list(_changed(compile(before, file, "exec"), compile(after, file, "exec")))
    except (SyntaxError, _ImportTimeChange):
        return None


class _ImportTimeChange(Exception):
    """Code differs outside of functions."""


def _changed(before: CodeType, after: CodeType) -> Iterator[tuple[CodeType, CodeType]]:
    """Yield changed functions of a module's or a class's code, and of the classes in it."""
    if _own(before) != _own(after):
        raise _ImportTimeChange
    for old, new in zip(_children(before), _children(after), strict=True):
        if old != new:
            if not old.co_flags & CO_OPTIMIZED:  # a class
                yield from _changed(old, new)
            elif old.co_freevars != new.co_freevars:
                raise _ImportTimeChange
            else:
                yield old, new


def _children(code: CodeType) -> list[CodeType]:
    return [value for value in code.co_consts if isinstance(value, CodeType)]


def _own(code: CodeType) -> tuple[object, ...]:
    """Return all of a code object but the functions and classes in it."""
    constants = [
        "code" if isinstance(value, CodeType) else (type(value), value) for value in code.co_consts
    ]
    return code.co_code, constants, code.co_names, code.co_varnames, len(_children(code))


def patch(changes: list[tuple[CodeType, CodeType]], functions: Functions) -> bool:
    """Give live functions their new code; return False if a changed one does not live."""
    matches = [(functions.get(_key(old), []), new) for old, new in changes]
    for live, new in matches:
        for function in live:
            function.__code__ = new
    return all(live for live, _ in matches)
