"""Finds constants of equal value and similar name in several modules: copies."""

__all__ = ["copied_constants"]

import ast
import re
from collections import defaultdict
from dataclasses import dataclass

from house.repository import PRODUCT, PythonFile, Repository
from house.violation import Measurement, Violation

_CONSTANT = re.compile(r"_?[A-Z][A-Z0-9_]*")
_CONTAINERS = ("frozenset", "set", "tuple", "dict", "MappingProxyType")
_QUANTITIES = frozenset(
    "byte chunk count default fewest highest largest least length level limit longest lowest max "  # noqa: SIM905
    "min most number part row rounding sample share shown size slack small smallest step tiny "
    "tolerance usual wide width".split()
)
"""Words that name a quantity without saying of what: ``_MOST = 3`` is a fact of its module."""
_LARGEST_ROUND = 16  # leading digits: 2.0, 0.05, 1e-6 and 16 are everywhere
_TRIVIAL = frozenset(["None", "True", "False", "0", "1", "2", "0.0", "1.0", "''", "()", "{}"])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Constant:
    """A module constant; ``value`` is comparable, ``text`` is the source text."""

    path: str
    line: int
    name: str
    value: str
    text: str

    @property
    def rank(self) -> tuple[int, bool, str, int]:
        """The sort key, which puts the constant that others should import first."""
        root = self.path.partition("/")[0]
        layer = PRODUCT.index(root) if root in PRODUCT else len(PRODUCT)
        return layer, self.name.startswith("_"), self.path, self.line

    @property
    def words(self) -> frozenset[str]:
        """The words of the constant's name, in the singular."""
        words = self.name.strip("_").lower().split("_")
        return frozenset(word.rstrip("s") or word for word in words)

    @property
    def is_distinctive(self) -> bool:
        """Whether an equal value is no coincidence: not a round number or a single word."""
        digits = self.value.lstrip("-").lower().partition("e")[0].replace(".", "").strip("0")
        if digits.isdigit():
            whole = int(digits)
            return whole > _LARGEST_ROUND and whole & (whole - 1) != 0
        return self.value not in _TRIVIAL

    def resembles(self, candidate: "_Constant") -> bool:
        """Return whether two constants of equal value have similar names or distinctive values.

        Case 1: the names agree, and say of what, or the value is distinctive. Case 2: one name
        says all that the other one says, and the value is distinctive.
        """
        common = self.words & candidate.words
        names_thing = bool(common - _QUANTITIES)
        if self.words == candidate.words:
            return names_thing or self.is_distinctive
        return names_thing and common in (self.words, candidate.words) and self.is_distinctive


def copied_constants(repository: Repository) -> Measurement:
    """Find constants of the product and the scripts that several modules define."""
    constants = [
        constant
        for file in repository.python
        if file.is_product or file.root == "scripts"
        for constant in _constants(file)
    ]
    by_value: dict[str, list[_Constant]] = defaultdict(list)
    for constant in constants:
        by_value[constant.value].append(constant)
    violations = [
        _violation(original, copy)
        for group in by_value.values()
        for original, copy in _copies(group)
        if repository.selects(copy.path)
    ]
    violations.sort(key=lambda violation: (violation.path, violation.line))
    return Measurement(violations, len(constants))


def _constants(file: PythonFile) -> list[_Constant]:
    constants = []
    for statement in file.tree.body:
        name, value = _assignment(statement)
        if value is not None and _CONSTANT.fullmatch(name) and _is_literal(value):
            constants.append(
                _Constant(
                    path=file.path,
                    line=statement.lineno,
                    name=name,
                    value=_normal(value),
                    text=ast.unparse(value),
                )
            )
    return constants


def _assignment(statement: ast.stmt) -> tuple[str, ast.expr | None]:
    match statement:
        case ast.Assign(targets=[ast.Name(id=name)], value=ast.expr() as value):
            return name, value
        case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
            return name, value
        case _:
            return "", None


def _is_literal(node: ast.expr) -> bool:
    match node:
        case ast.Constant():
            return True
        case ast.UnaryOp(operand=operand):
            return _is_literal(operand)
        case ast.BinOp(left=left, right=right):
            return _is_literal(left) and _is_literal(right)
        case ast.Tuple(elts=parts) | ast.List(elts=parts) | ast.Set(elts=parts):
            return all(_is_literal(part) for part in parts)
        case ast.Dict(keys=keys, values=values):
            return all(part is not None and _is_literal(part) for part in [*keys, *values])
        case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]):
            return name in _CONTAINERS and _is_literal(argument)
        case _:
            return False


def _normal(node: ast.expr) -> str:
    """Return a constant's value as text, with sets sorted and arithmetic computed."""
    match node:
        case ast.Call(args=[argument]):
            return _normal(argument)
        case ast.List(elts=parts) | ast.Tuple(elts=parts):
            return "(" + ", ".join(_normal(part) for part in parts) + ")" if parts else "()"
        case ast.Set(elts=parts):
            return "(" + ", ".join(sorted(_normal(part) for part in parts)) + ")"
        case ast.BinOp(left=left, op=op, right=right):
            return _computed(left, op, right)
        case _:
            return ast.unparse(node)


def _computed(left: ast.expr, op: ast.operator, right: ast.expr) -> str:
    """Return the result of integer powers, shifts and products, such as ``1 << 20``."""
    try:
        first, second = int(_normal(left)), int(_normal(right))
    except ValueError:
        return f"{_normal(left)} {type(op).__name__} {_normal(right)}"
    match op:
        case ast.Mult():
            return str(first * second)
        case ast.LShift() if second < 128:
            return str(first << second)
        case ast.Pow() if 0 <= second < 128:
            return str(first**second)
        case ast.Sub():
            return str(first - second)
        case ast.Add():
            return str(first + second)
        case _:
            return f"{first} {type(op).__name__} {second}"


def _copies(group: list[_Constant]) -> list[tuple[_Constant, _Constant]]:
    """Return pairs of constants: the original, and its copy in another module.

    The original is that of the lowest layer, and in one layer the public one.
    """
    copies: list[tuple[_Constant, _Constant]] = []
    originals: list[_Constant] = []
    for constant in sorted(group, key=lambda constant: constant.rank):
        original = next((known for known in originals if known.resembles(constant)), None)
        if original is None:
            originals.append(constant)
        elif original.path != constant.path:
            copies.append((original, constant))
    return copies


def _violation(original: _Constant, copy: _Constant) -> Violation:
    text = copy.text if len(copy.text) <= 60 else copy.text[:57] + "..."
    return Violation(
        path=copy.path,
        line=copy.line,
        subject=copy.name,
        actual=f"{copy.name} = {text} repeats {original.name}, {original.path}:{original.line}",
        expected="one definition",
        hint="import it from the lowest module that knows the fact, or name what differs",
    )
