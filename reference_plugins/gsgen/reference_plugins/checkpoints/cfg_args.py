"""The options of a training run, as ``cfg_args`` records them.

The file is one line, ``str(argparse.Namespace)``: ``Namespace(feat_dim=32, eval=True, …)``. The
published loaders hand it to ``eval``; here it is parsed, and only literals are taken.
"""

__all__ = ["CfgArgs", "read_cfg_args"]

import ast
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gsgen.reference_plugins.checkpoints.errors import CheckpointInvalid

_NAME = "cfg_args"
_MOST_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class CfgArgs:
    """The options of one training run.

    Attributes:
        path: Where they were read.
        values: Option → literal; empty where the file is absent.
        present: Whether there was a file.
    """

    path: Path
    values: dict[str, Any]
    present: bool = True

    def flag(self, name: str, default: bool = False) -> bool:
        """Return a yes or no."""
        value = self.values.get(name, default)
        if not isinstance(value, bool):
            raise self._unlike(name, "True or False")
        return value

    def integer(self, name: str, default: int) -> int:
        """Return a whole number."""
        value = self.values.get(name, default)
        if not isinstance(value, int) or isinstance(value, bool):
            raise self._unlike(name, "a whole number")
        return value

    def number(self, name: str, default: float) -> float:
        """Return a number."""
        value = self.values.get(name, default)
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise self._unlike(name, "a number")
        return float(value)

    def word(self, name: str, default: str, known: Iterable[str] = ()) -> str:
        """Return a word, one of ``known`` if that is given."""
        value = self.values.get(name, default)
        choices = tuple(known)
        if not isinstance(value, str) or (choices and value not in choices):
            raise self._unlike(name, " or ".join(map(repr, choices)) or "a word")
        return value

    def _unlike(self, name: str, wanted: str) -> CheckpointInvalid:
        seen = repr(self.values[name])[:80]
        return CheckpointInvalid(f"{name} is {seen}, wanted {wanted}", where=str(self.path))


def read_cfg_args(folder: Path, *, required: bool = False) -> CfgArgs:
    """Read ``cfg_args`` of the training run in ``folder``.

    Args:
        folder: The output folder of a training run.
        required: The method cannot be exported without.

    Raises:
        CheckpointInvalid: The file is missing but required, or is no ``Namespace`` of literals.
    """
    path = folder / _NAME
    if not path.is_file():
        if required:
            mend = f"Copy {_NAME} from the folder that training wrote: its flags change the result."
            raise CheckpointInvalid("is missing", where=str(path), mend=mend)
        return CfgArgs(path, {}, present=False)
    return CfgArgs(path, _parsed(path))


def _parsed(path: Path) -> dict[str, Any]:
    mend = "Wanted one line: Namespace(name=literal, …), as the training code writes it."
    if path.stat().st_size > _MOST_BYTES:
        raise CheckpointInvalid(
            f"is larger than {_MOST_BYTES} bytes", where=str(path), mend=mend
        )
    try:
        tree = ast.parse(path.read_text("utf-8").strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        reason = getattr(error, "msg", str(error))
        raise CheckpointInvalid(
            f"cannot be parsed: {reason}", where=str(path), mend=mend
        ) from error
    if not (
        isinstance(tree, ast.Call)
        and isinstance(tree.func, ast.Name)
        and tree.func.id == "Namespace"
        and not tree.args
        and all(keyword.arg or _is_unspellable(keyword.value) for keyword in tree.keywords)
    ):
        raise CheckpointInvalid("is no Namespace(…)", where=str(path), mend=mend)
    values: dict[str, Any] = {}
    for keyword in tree.keywords:
        value = _literal(keyword, path)
        values |= {keyword.arg: value} if keyword.arg else value
    return values


def _is_unspellable(value: ast.expr) -> bool:
    """Whether this is how argparse prints options whose names are no identifiers: ``**{'a-b': 1}``."""
    return isinstance(value, ast.Dict) and all(
        isinstance(key, ast.Constant)
        and isinstance(key.value, str)
        and not key.value.isidentifier()
        for key in value.keys
    )


def _literal(keyword: ast.keyword, path: Path) -> Any:
    try:
        return ast.literal_eval(_NotFinite().visit(keyword.value))
    except (ValueError, TypeError, RecursionError, MemoryError) as error:
        seen = ast.unparse(keyword.value)[:80]
        raise CheckpointInvalid(
            f"{keyword.arg or 'an option'} is {seen}, wanted a literal", where=str(path)
        ) from error


class _NotFinite(ast.NodeTransformer):
    """Reads ``inf`` and ``nan``, as Python prints numbers that have no literal."""

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return ast.Constant(float(node.id)) if node.id in ("inf", "nan") else node
