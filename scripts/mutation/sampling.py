"""Draws mutants of the code over all rooms, and leaves out those that no test can notice."""

import ast
import difflib
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

PACKAGES = ("contract", "sdk", "runtime", "reference_plugins")
SKIPPED_OPERATORS = ("BitOr", "ExceptionReplacer")
"""Parts of names. Most `|` join types in annotations, where every mutant fails at import; the
replacer of exceptions fails on names with dots."""
IDLE_DECORATORS = frozenset({"cache", "final", "lru_cache", "override", "wraps"})
"""Decorators that type checkers read, or that save time: results are the same without them."""
GUARDS = frozenset({"frozen", "kw_only", "slots", "strict"})
"""Flags that refuse what only a wrong program does, as `zip(a, b, strict=True)`."""


@dataclass(frozen=True, slots=True)
class Mutant:
    """A changed module.

    Attributes:
        path: The module, from the repository's root.
        operator: Name of cosmic-ray's operator.
        code: Its mutated code.
        diff: The changed lines.
    """

    path: Path
    operator: str
    code: str
    diff: str


def draw(seed: int, number: int, root: Path) -> Mutant:
    """Choose a room, a module in it, and a mutation of it; rooms are equally likely.

    Choices are the smallest hash of what there is to choose from, so that a module that is added
    or changed elsewhere leaves most of the sample as it was.
    """
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator, operator_names

    modules = [file for package in PACKAGES for file in (root / package / "gsgen").rglob("*.py")]
    rooms = sorted({file.parent.relative_to(root).as_posix() for file in modules})
    names = [name for name in operator_names() if not any(x in name for x in SKIPPED_OPERATORS)]
    for attempt in range(1000):
        key = f"{seed} {number} {attempt}"
        room = root / _shuffled(rooms, key)[0]
        file = room / _shuffled([path.name for path in room.glob("*.py")], key)[0]
        code = file.read_text("utf-8")
        nodes = list(ast_nodes(get_ast(code)))
        for name in _shuffled(names, key):
            operator_class = get_operator(name)
            if operator_class.arguments():
                continue
            operator = operator_class()
            positions = sum(len(list(operator.mutation_positions(node))) for node in nodes)
            if positions:
                mutated = mutate_code(code, operator, _hash(key) % positions)
                if mutated and not is_equivalent(code, mutated):
                    return Mutant(file.relative_to(root), name, mutated, _diff(code, mutated))
                break
    raise LookupError(f"no mutation for seed {seed}, number {number}")


def _shuffled(names: Sequence[str], key: str) -> list[str]:
    return sorted(names, key=lambda name: _hash(f"{key} {name}"))


def _hash(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")


def is_equivalent(before: str, after: str) -> bool:
    """Tell whether two modules differ only in what no test can notice, or if one is no Python.

    These kinds are left out, whether or not a test would kill some:

    1. annotations, docstrings and ``__all__``;
    2. numbers and operators inside the text of a raised error;
    3. decorators that type checkers read, or that cache;
    4. flags that refuse what only a wrong program does (``frozen``, ``slots``, ``strict`` …);
    5. ``is None`` as ``== None``, which only arrays tell apart;
    6. blocks under ``if TYPE_CHECKING``;
    7. the ``*`` before keyword-only parameters as ``/``: it is no operator.
    """
    try:
        return _essence(before) == _essence(after)
    except SyntaxError:
        return True


def _essence(code: str) -> str:
    return ast.dump(_Essence().visit(ast.parse(code)))


class _Essence(ast.NodeTransformer):
    """Removes from a syntax tree what :func:`is_equivalent` leaves out, by its cases."""

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None  # Case 1
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Constant(None)  # Case 1
        return self.generic_visit(node)

    def visit_arguments(self, node: ast.arguments) -> ast.AST:
        # Case 7: parameters of all kinds become keyword-only ones, with their defaults.
        self.generic_visit(node)
        defaults = [*[None] * (len(node.posonlyargs) + len(node.args) - len(node.defaults))]
        defaults += [*node.defaults, *node.kw_defaults]
        parameters = [*node.posonlyargs, *node.args, *node.kwonlyargs]
        node.posonlyargs, node.args, node.defaults = [], [], []
        node.kwonlyargs, node.kw_defaults = parameters, defaults
        return node

    def visit_Assign(self, node: ast.Assign) -> ast.AST | None:
        names = [target.id for target in node.targets if isinstance(target, ast.Name)]
        return None if names == ["__all__"] else self.generic_visit(node)  # Case 1

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None  # Case 1
        node.decorator_list = [x for x in node.decorator_list if _name(x) not in IDLE_DECORATORS]
        return self.generic_visit(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        node.decorator_list = [x for x in node.decorator_list if _name(x) not in IDLE_DECORATORS]
        return self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> ast.AST:
        return ast.Pass() if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        self.generic_visit(node)
        for text in (child for child in ast.walk(node) if isinstance(child, ast.JoinedStr)):
            text.values = []  # Case 2
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        node.keywords = [word for word in node.keywords if word.arg not in GUARDS]  # Case 4
        return self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        with_none = [isinstance(x, ast.Constant) and x.value is None for x in node.comparators]
        swaps: dict[type, type[ast.cmpop]] = {ast.Is: ast.Eq, ast.IsNot: ast.NotEq}
        node.ops = [  # Case 5
            swaps.get(type(operator), type(operator))() if is_none else operator
            for operator, is_none in zip(node.ops, with_none, strict=True)
        ]
        return node

    def visit_If(self, node: ast.If) -> ast.AST:
        is_static = "TYPE_CHECKING" in ast.dump(node.test)
        return ast.Pass() if is_static else self.generic_visit(node)  # Case 6


def _name(decorator: ast.expr) -> str:
    node = decorator.func if isinstance(decorator, ast.Call) else decorator
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def _diff(before: str, after: str) -> str:
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    return "\n".join(f"    {line}" for line in list(lines)[2:])
