"""Integers that record how they were computed, so that buffer sizes are saved as formulas."""

__all__ = ["UNLIMITED", "Formula", "Tree", "evaluate", "replaced", "tree_of"]

import operator
from collections.abc import Callable, Mapping
from typing import Final, TypeAlias, final

Tree: TypeAlias = int | str | list["Tree"]
"""A formula as JSON: an integer, the name of a size, or an operator with its operands."""

UNLIMITED: Final = 1 << 62
"""A limit that no recorded size exceeds; the client compares sizes with its own device's."""

_BINARY: Final[dict[str, Callable[[int, int], int]]] = {
    "add": operator.add,
    "sub": operator.sub,
    "mul": operator.mul,
    "floor_div": operator.floordiv,
    "ceil_div": lambda a, b: -(-a // b),
    "mod": operator.mod,
    "lt": operator.lt,
    "le": operator.le,
    "gt": operator.gt,
    "ge": operator.ge,
    "eq": operator.eq,
    "ne": operator.ne,
}
_UNARY: Final[dict[str, Callable[[int], int]]] = {
    "neg": operator.neg,
    "abs": abs,
    "bits": int.bit_length,
}


def evaluate(tree: Tree, sizes: Mapping[str, int]) -> int:
    """Evaluate a recorded size formula for given values of the named sizes."""
    if isinstance(tree, int):
        return tree
    if isinstance(tree, str):
        return sizes[tree]
    name, operands = str(tree[0]), [evaluate(operand, sizes) for operand in tree[1:]]
    return int(_UNARY[name](*operands) if name in _UNARY else _BINARY[name](*operands))


def replaced(tree: Tree, old: Tree, new: Tree) -> Tree:
    """Return a size formula in which each occurrence of one subformula is replaced by another."""
    if tree == old:
        return new
    return [replaced(part, old, new) for part in tree] if isinstance(tree, list) else tree


@final
class Formula(int):
    """An integer that also records the size formula from which it was computed.

    Comparisons decide which steps a plan has. So each one that was true is kept in ``guards`` as a
    formula that must be true wherever the plan is used; of a false one, the opposite.

    Attributes:
        tree: The formula.
        guards: Conditions of the recording, which all of its formulas share.
    """

    tree: Tree
    guards: list[Tree]

    def __new__(cls, value: int, tree: Tree, guards: list[Tree]) -> "Formula":
        """Create an integer with the formula (arithmetic on named sizes) that computes it."""
        formula = super().__new__(cls, value)
        formula.tree, formula.guards = tree, guards
        return formula

    def _unary(self, name: str) -> "Formula":
        return Formula(_UNARY[name](int(self)), [name, self.tree], self.guards)

    def _binary(self, name: str, left: int, right: int) -> "Formula":
        value = _BINARY[name](int(left), int(right))
        return Formula(value, _simple(name, tree_of(left), tree_of(right)), self.guards)

    def _compare(self, name: str, other: object) -> bool:
        assert isinstance(other, int), "a size is compared with another type"
        holds = bool(_BINARY[name](int(self), int(other)))
        if other != UNLIMITED:
            opposite = {"lt": "ge", "ge": "lt", "gt": "le", "le": "gt", "eq": "ne", "ne": "eq"}
            guard: Tree = [name if holds else opposite[name], self.tree, tree_of(other)]
            if guard not in self.guards:
                self.guards.append(guard)
        return holds

    def __add__(self, other: int) -> "Formula":
        return self._binary("add", self, other)

    def __radd__(self, other: int) -> "Formula":
        return self._binary("add", other, self)

    def __sub__(self, other: int) -> "Formula":
        return self._binary("sub", self, other)

    def __rsub__(self, other: int) -> "Formula":
        return self._binary("sub", other, self)

    def __mul__(self, other: int) -> "Formula":
        return self._binary("mul", self, other)

    def __rmul__(self, other: int) -> "Formula":
        return self._binary("mul", other, self)

    def __floordiv__(self, other: int) -> "Formula":
        return self._binary("floor_div", self, other)

    def __rfloordiv__(self, other: int) -> "Formula":
        return self._binary("floor_div", other, self)

    def __mod__(self, other: int) -> "Formula":
        return self._binary("mod", self, other)

    def __neg__(self) -> "Formula":
        tree = self.tree
        # −(−a // b) is how Python writes a quotient that is rounded up.
        if isinstance(tree, list) and tree[0] == "floor_div":
            dividend = tree[1]
            if isinstance(dividend, list) and dividend[0] == "neg":
                return Formula(-int(self), ["ceil_div", dividend[1], tree[2]], self.guards)
        return self._unary("neg")

    def __abs__(self) -> "Formula":
        return self._unary("abs")

    def __lt__(self, other: object) -> bool:
        return self._compare("lt", other)

    def __le__(self, other: object) -> bool:
        return self._compare("le", other)

    def __gt__(self, other: object) -> bool:
        return self._compare("gt", other)

    def __ge__(self, other: object) -> bool:
        return self._compare("ge", other)

    def __eq__(self, other: object) -> bool:
        return self._compare("eq", other)

    def __ne__(self, other: object) -> bool:
        return self._compare("ne", other)

    def __bool__(self) -> bool:
        return self._compare("ne", 0)

    def __hash__(self) -> int:
        return int.__hash__(self)

    def bit_length(self) -> int:
        """Return the bit length, and limit the recorded GPU plan to values of at most this length.

        The tile sort asks for it, to sort by no more bits than tiles need. More do no harm.
        """
        bits = int(self).bit_length()
        self.guards.append(["le", ["bits", self.tree], bits])
        return bits


def tree_of(value: int) -> Tree:
    """Return the recorded formula of an integer, or the integer itself without a formula."""
    return value.tree if isinstance(value, Formula) else int(value)


def _simple(name: str, left: Tree, right: Tree) -> Tree:
    """Return a binary operation of two size formulas, without neutral operands (+ 0, × 1).

    A product that is divided by its first factor is the second factor.
    """
    if name == "add" and left == 0:
        return right
    if name in ("add", "sub") and right == 0:
        return left
    if name == "mul" and left == 1:
        return right
    if name in ("mul", "floor_div", "ceil_div") and right == 1:
        return left
    if name == "floor_div" and isinstance(left, list) and left[:2] == ["mul", right]:
        return left[2]
    return [name, left, right]
