"""Names that a file binds: variables, parameters, comprehension targets and attributes."""

__all__ = ["Binding", "bindings"]

import ast
from collections.abc import Iterator
from dataclasses import dataclass

_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
_COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)
_LEAVES = (ast.Constant, ast.expr_context, ast.operator, ast.cmpop, ast.unaryop, ast.boolop)
_CONVENTIONAL = {"self", "cls", "mcs", "_"}


@dataclass(frozen=True, slots=True)
class Binding:
    """The first binding of a name in one scope.

    Attributes:
        name: The name as written.
        line: Line in the file, from 1.
        kind: ``parameter``, ``comprehension``, ``attribute`` or ``variable``.
        scope: Qualified name of the enclosing function or class; empty for the module.
    """

    name: str
    line: int
    kind: str
    scope: str


class _Scope:
    """One scope and the names that it has bound so far."""

    def __init__(self, kind: str, qualname: str, parent: "_Scope | None") -> None:
        self.kind = kind
        self.qualname = qualname
        self.parent = parent
        self.names: dict[str, Binding] = {}
        self.foreign: set[str] = set()  # declared global or nonlocal

    def bind(self, name: str, line: int, kind: str) -> None:
        """Record the earliest line at which the scope binds a name."""
        known = self.names.get(name)
        if name in self.foreign or name in _CONVENTIONAL or name.startswith("__"):
            return
        if known is None or line < known.line:
            self.names[name] = Binding(name, line, kind, self.qualname)

    def enclosing(self, *kinds: str) -> "_Scope | None":
        """Return the nearest enclosing scope of one of the kinds, this scope included."""
        scope: _Scope | None = self
        while scope is not None and scope.kind not in kinds:
            scope = scope.parent
        return scope

    def named(self, name: str) -> str:
        """Return the qualified name of a definition in this scope."""
        return f"{self.qualname}.{name}" if self.qualname else name


def bindings(tree: ast.Module) -> Iterator[Binding]:
    """Yield each binding once per scope, except ``self`` and dunder names."""
    scopes = [_Scope("module", "", None)]
    pending: list[tuple[ast.AST, _Scope]] = [(tree, scopes[0])]
    while pending:
        node, scope = pending.pop()
        inner = _inner_scope(node, scope)
        if inner is not scope:
            scopes.append(inner)
        _bind(node, scope)
        pending.extend((child, inner) for child in _children(node))
    for scope in scopes:
        yield from scope.names.values()


def _children(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the child nodes of an AST node, except leaves, which bind no names."""
    for field in node._fields:
        value = getattr(node, field, None)
        if isinstance(value, list):
            for child in value:
                if isinstance(child, ast.AST) and not isinstance(child, _LEAVES):
                    yield child
        elif isinstance(value, ast.AST) and not isinstance(value, _LEAVES):
            yield value


def _inner_scope(node: ast.AST, scope: _Scope) -> _Scope:
    """Return the scope of an AST node's children."""
    if isinstance(node, ast.ClassDef):
        return _Scope("class", scope.named(node.name), scope)
    if isinstance(node, _FUNCTIONS):
        name = getattr(node, "name", "")
        inner = _Scope("function", scope.named(name) if name else scope.qualname, scope)
        if name:
            inner.foreign = _foreign_names(node)
        return inner
    if isinstance(node, _COMPREHENSIONS):
        return _Scope("comprehension", scope.qualname, scope)
    return scope


def _foreign_names(function: ast.AST) -> set[str]:
    """Return the names that a function declares global or nonlocal."""
    names: set[str] = set()
    pending = list(ast.iter_child_nodes(function))
    while pending:
        node = pending.pop()
        if isinstance(node, ast.Global | ast.Nonlocal):
            names.update(node.names)
        elif (
            isinstance(node, ast.stmt) and not isinstance(node, (*_FUNCTIONS, ast.ClassDef))
        ) or isinstance(node, ast.ExceptHandler | ast.match_case):
            pending.extend(ast.iter_child_nodes(node))
    return names


def _bind(node: ast.AST, scope: _Scope) -> None:
    """Record the names that a single AST node binds."""
    match node:
        case ast.NamedExpr(target=ast.Name(id=name)):  # binds outside of comprehensions
            holder = scope.enclosing("function", "class", "module")
            assert holder is not None, "a module encloses every scope"
            holder.bind(name, node.lineno, "variable")
            # The target is visited as well, as a name in the comprehension.
            scope.foreign = scope.foreign | ({name} if holder is not scope else set())
        case ast.Name(id=name, ctx=ast.Store()):
            kinds = {"class": "attribute", "comprehension": "comprehension"}
            scope.bind(name, node.lineno, kinds.get(scope.kind, "variable"))
        case ast.arg(arg=name):
            scope.bind(name, node.lineno, "parameter")
        case ast.ExceptHandler(name=str(name)):
            scope.bind(name, node.lineno, "variable")
        case ast.MatchAs(name=str(name)) | ast.MatchStar(name=str(name)):
            scope.bind(name, node.lineno, "variable")
        case ast.MatchMapping(rest=str(name)):
            scope.bind(name, node.lineno, "variable")
        case ast.Attribute(value=ast.Name(id="self"), attr=name, ctx=ast.Store()):
            owner = scope.enclosing("class")
            if owner is not None:
                owner.bind(name, node.lineno, "attribute")
        case _:
            pass
