"""Finds unclear signatures: many positional fields, positional booleans, ``Any``."""

__all__ = ["any_types", "positional_booleans", "positional_fields"]

import ast
import re
from collections.abc import Iterator

from house.repository import PythonFile, Repository
from house.violation import Measurement, Violation

_MOST_FIELDS = 4
_ANY = re.compile(r"\bAny\b")
Function = ast.FunctionDef | ast.AsyncFunctionDef


def positional_fields(repository: Repository) -> Measurement:
    """Find classes of more than four fields that can be, or are, built by position.

    Case 1: a dataclass must be ``kw_only``, by its decorator, ``KW_ONLY`` or each field. Case 2: a
    NamedTuple has no such option, so every call of it in the product must name the fields.
    """
    violations: list[Violation] = []
    classes = _classes(repository)
    tuples = {
        node.name
        for node in classes.values()
        if _is_named_tuple(node) and len(_fields(node, classes)) > _MOST_FIELDS
    }
    total = 0
    for file in repository.product:
        if not repository.selects(file.path):
            continue
        for name, node in file.definitions:
            if isinstance(node, ast.ClassDef):
                total += 1
                violations += _positional_dataclass(file, name, node, classes)
        violations += _positional_calls(file, tuples)
    return Measurement(violations, total)


def _classes(repository: Repository) -> dict[str, ast.ClassDef]:
    """Return the product's classes by name, without names of several classes."""
    classes: dict[str, ast.ClassDef] = {}
    ambiguous: set[str] = set()
    for file in repository.product:
        for _, node in file.definitions:
            if isinstance(node, ast.ClassDef):
                ambiguous |= {node.name} & set(classes)
                classes[node.name] = node
    return {name: node for name, node in classes.items() if name not in ambiguous}


def positional_booleans(repository: Repository) -> Measurement:
    """Find boolean parameters of the product that a caller may pass by position.

    Functions whose parameters are options of the command line are left out: the command line
    parser calls them by keyword, and a person by ``--name``.
    """
    violations: list[Violation] = []
    total = 0
    for file in repository.product:
        if not repository.selects(file.path):
            continue
        for name, node in file.definitions:
            if isinstance(node, ast.ClassDef):
                continue
            total += 1
            if not _is_command(node) and not _is_setter(node):
                violations += _boolean_violations(file, name, node)
    return Measurement(violations, total)


def any_types(repository: Repository) -> Measurement:
    """Find uses of ``Any`` in the runtime, counted against its lines."""
    violations: list[Violation] = []
    lines = 0
    for file in repository.selected:
        if file.root != "runtime":
            continue
        lines += len(file.lines)
        violations += [
            Violation(
                path=file.path,
                line=line,
                subject="Any",
                actual=f"Any: {file.lines[line - 1].strip()}",
                expected="a type",
                hint="use an alias such as Buffer or Texture, a protocol, or object",
            )
            for line in sorted(_any_lines(file))
        ]
    return Measurement(violations, lines)


def _dataclass_decorator(node: ast.ClassDef) -> ast.expr | None:
    for decorator in node.decorator_list:
        if _last_name(decorator) == "dataclass":
            return decorator
    return None


def _is_named_tuple(node: ast.ClassDef) -> bool:
    return any(_last_name(base) == "NamedTuple" for base in node.bases)


def _last_name(node: ast.expr) -> str:
    match node:
        case ast.Call(func=func):
            return _last_name(func)
        case ast.Attribute(attr=name) | ast.Name(id=name):
            return name
        case _:
            return ""


def _fields(node: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> list[str]:
    """Return the fields of a class that may be passed by position, inherited ones first."""
    decorator = _dataclass_decorator(node)
    if _keywords(decorator).get("kw_only") == "True":
        return []
    bases = [classes[name] for base in node.bases if (name := _last_name(base)) in classes]
    names = [name for base in bases if base is not node for name in _fields(base, classes)]
    for statement in node.body if decorator is not None or _is_named_tuple(node) else []:
        if not isinstance(statement, ast.AnnAssign) or not isinstance(statement.target, ast.Name):
            continue
        annotation = ast.unparse(statement.annotation)
        if "KW_ONLY" in annotation:
            break
        options = _keywords(statement.value)
        if "ClassVar" not in annotation and options.get("init") != "False":
            names += [] if options.get("kw_only") == "True" else [statement.target.id]
    return list(dict.fromkeys(names))


def _keywords(call: ast.expr | None) -> dict[str, str]:
    if not isinstance(call, ast.Call):
        return {}
    return {keyword.arg: ast.unparse(keyword.value) for keyword in call.keywords if keyword.arg}


def _positional_dataclass(
    file: PythonFile, name: str, node: ast.ClassDef, classes: dict[str, ast.ClassDef]
) -> Iterator[Violation]:
    count = len(_fields(node, classes))
    if count > _MOST_FIELDS and _dataclass_decorator(node) is not None:
        yield Violation(
            path=file.path,
            line=node.lineno,
            subject=name,
            actual=f"{name} has {count} positional fields",
            expected=f"kw_only=True for more than {_MOST_FIELDS} fields",
            hint="add kw_only=True, and name the fields where the class is built",
        )


def _positional_calls(file: PythonFile, tuples: set[str]) -> Iterator[Violation]:
    for node in file.nodes:
        if isinstance(node, ast.Call) and _last_name(node.func) in tuples:
            values = [value for value in node.args if not isinstance(value, ast.Starred)]
            if values:
                yield Violation(
                    path=file.path,
                    line=node.lineno,
                    subject=_last_name(node.func),
                    actual=f"{_last_name(node.func)}(…) with {len(values)} positional values",
                    expected=f"keywords for more than {_MOST_FIELDS} fields",
                    hint="name the fields",
                )


def _is_command(node: Function) -> bool:
    """Return whether a parameter is declared as an option or argument of a command."""
    parameters = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return any(
        isinstance(part, ast.Call) and _last_name(part) in ("Option", "Argument")
        for parameter in parameters
        if parameter.annotation is not None
        for part in ast.walk(parameter.annotation)
    )


def _is_setter(node: Function) -> bool:
    """Return whether the function is a property's setter, whose value has no name at the call."""
    return any(
        isinstance(decorator, ast.Attribute) and decorator.attr == "setter"
        for decorator in node.decorator_list
    )


def _boolean_violations(file: PythonFile, name: str, node: Function) -> Iterator[Violation]:
    parameters = [*node.args.posonlyargs, *node.args.args]
    padding = [None] * (len(parameters) - len(node.args.defaults))
    defaults: list[ast.expr | None] = [*padding, *node.args.defaults]
    for parameter, default in zip(parameters, defaults, strict=True):
        if _is_boolean(parameter.annotation, default):
            yield Violation(
                path=file.path,
                line=parameter.lineno,
                subject=f"{name}.{parameter.arg}",
                actual=f"boolean {parameter.arg!r} of {name} may be passed by position",
                expected="a keyword-only parameter",
                hint="put `*,` before it, and its name into the calls",
            )


def _is_boolean(annotation: ast.expr | None, default: ast.expr | None) -> bool:
    if isinstance(default, ast.Constant) and isinstance(default.value, bool):
        return True
    return annotation is not None and ast.unparse(annotation) in (
        "bool",
        "bool | None",
        "Optional[bool]",
    )


def _any_lines(file: PythonFile) -> list[int]:
    """Return the line of each use of ``Any``, in quoted annotations too."""
    lines = [
        node.lineno
        for node in file.nodes
        if isinstance(node, ast.Name | ast.Attribute) and _last_name(node) == "Any"
    ]
    for node in file.nodes:
        for annotation in _annotations(node):
            for part in ast.walk(annotation):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    lines += [part.lineno] * len(_ANY.findall(part.value))
    return lines


def _annotations(node: ast.AST) -> Iterator[ast.expr]:
    match node:
        case ast.AnnAssign(annotation=annotation):
            yield annotation
        case ast.arg(annotation=ast.expr() as annotation):
            yield annotation
        case ast.FunctionDef(returns=ast.expr() as annotation):
            yield annotation
        case ast.AsyncFunctionDef(returns=ast.expr() as annotation):
            yield annotation
