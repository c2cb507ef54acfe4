"""Translates a subset of Python functions and dataclasses to JavaScript, node by node.

The operations of Python on values (truth, equality, formatting, …) are functions of the client's
module ``python.js``, which generated code calls as ``py.name``.
"""

__all__ = ["FunctionTranslator", "Untranslatable", "literal"]

import ast
import json
from collections.abc import Callable, Iterator
from typing import Final

Resolve = Callable[[str], str | None]
Bind = Callable[[ast.Call], "list[ast.expr | None] | None"]

# Names that a Python function may give to a local, and JavaScript may not.
_RESERVED: Final = frozenset(
    {
        *("arguments", "await", "case", "catch", "class", "const", "default", "delete", "do"),
        *("enum", "eval", "export", "extends", "function", "import", "in", "instanceof"),
        *("interface", "let", "new", "null", "package", "private", "protected", "public", "py"),
        *("static", "super", "switch", "this", "throw", "typeof", "undefined", "var", "void"),
        *("with", "yield"),
    }
)
_METHODS: Final = {
    "add": "{0}.add({1})",
    "append": "{0}.push({1})",
    "count": "py.count({0}, {1})",
    "decode": "{0}",
    "encode": "{0}",
    "endswith": "py.endsWith({0}, {1})",
    "extend": "{0}.push(...py.iter({1}))",
    "finditer": "{1}.matchAll(new RegExp({0}, `g${{{0}.flags}}`))",
    "fullmatch": "new RegExp(`^(?:${{{0}.source}})$`, {0}.flags).exec({1})",
    "get": "py.get({all})",
    "index": "{0}.indexOf({1})",
    "is_integer": "Number.isInteger(Number({0}))",
    "isascii": r"/^[\0-\x7f]*$/.test({0})",
    "isdigit": r"/^\d+$/.test({0})",
    "isdisjoint": "!py.list({1}).some((entry) => {0}.has(entry))",
    "issubset": "py.list({0}).every((entry) => {1}.has(entry))",
    "isprintable": r"!/[\p{{C}}\p{{Zl}}\p{{Zp}}]|(?! )\p{{Zs}}/u.test({0})",
    "items": "{0}.entries()",
    "join": "py.list({1}).join({0})",
    "lower": "{0}.toLowerCase()",
    "lstrip": "{0}.trimStart()",
    "match": "{0}.exec({1})",  # patterns that begin with ^
    "partition": "py.partition({0}, {1})",
    "pop": "{0}.pop()",
    "rpartition": "py.rpartition({0}, {1})",
    "search": "{0}.exec({1})",
    "split": "{0}.split({1})",
    "splitlines": r"{0}.split(/\r\n|[\n\v\f\r\x1c-\x1e\x85\u2028\u2029]/)",
    "startswith": "py.startsWith({0}, {1})",
    "strip": "{0}.trim()",
    "update": "py.list({1}).forEach((entry) => {0}.add(entry))",
    "values": "{0}.values()",
}
"""Methods of Python's own types."""

_BUILTINS: Final = {
    "py.chain": "[{0}, {1}].flatMap((part) => py.list(part))",
    "py.all": "py.list({0}).every(py.bool)",
    "py.any": "py.list({0}).some(py.bool)",
    "py.enumerate": "py.list({0}).entries()",
    "py.filter": "py.list({1}).filter(py.bool)",
    "py.getattr": "{0}[{1}]",
    "py.id": "{0}",
    "py.fromkeys": "py.dict(py.map((key) => [key, null], {0}))",
    "py.next": "({0}.next().value ?? {1})",
    "py.prod": "py.list({0}).reduce((product, size) => product * size, 1)",
    "py.range": "Array({0}).keys()",
    "py.reversed": "py.list({0}).reverse()",
    "py.search": "new RegExp({0}).exec({1})",
    "py.sum": "py.list({0}).reduce(py.plus, 0)",
    "py.type": "{0}.constructor",
}
"""Calls of Python's own functions that JavaScript has, too; others are in ``python.js``."""

_VALUES: Final = {"py.abs": "Math.abs", "py.frozenset": "py.set", "py.tuple": "py.list"}
"""Python's functions and types where they are not called."""

_COMPARISONS: Final = {
    ast.Eq: "py.eq({0}, {1})",
    ast.NotEq: "!py.eq({0}, {1})",
    ast.Lt: "py.compare({0}, {1}) < 0",
    ast.LtE: "py.compare({0}, {1}) <= 0",
    ast.Gt: "py.compare({0}, {1}) > 0",
    ast.GtE: "py.compare({0}, {1}) >= 0",
    ast.In: "py.contains({1}, {0})",
    ast.NotIn: "!py.contains({1}, {0})",
    ast.Is: "{0} === {1}",
    ast.IsNot: "{0} !== {1}",
}
_OPERATIONS: Final = {
    ast.Add: "py.plus({0}, {1})",
    ast.Sub: "py.minus({0}, {1})",
    ast.Mult: "{0} * {1}",
    ast.Div: "{0} / {1}",
    ast.FloorDiv: "Math.floor({0} / {1})",
    ast.Mod: "{0} - {1} * Math.floor({0} / {1})",
    ast.Pow: "{0} ** {1}",
    ast.BitOr: "py.union({0}, {1})",
    ast.LShift: "{0} * 2 ** {1}",
}
_ERRORS: Final = {"ValueError": "SyntaxError", "RecursionError": "RangeError"}
"""The errors of JavaScript's JSON in place of Python's."""

_GENERIC: Final = frozenset({"dict", "list", "set"})
_YES_OR_NO: Final = frozenset({"all", "any", "isinstance"})


class Untranslatable(ValueError):
    """Raised if a Python statement or expression has no translation to JavaScript."""


def literal(value: object) -> str:
    """Return a JavaScript expression for a plain Python value: numbers, texts, None."""
    if value is None or isinstance(value, (bool, str)):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, bytes):  # each byte is a character
        return json.dumps(value.decode("latin-1"))
    if isinstance(value, float):
        return f"py.float({value!r})" if value.is_integer() else repr(value)
    if isinstance(value, int):
        return str(value)
    raise Untranslatable(f"a constant of type {type(value).__name__}")


def _name(name: str) -> str:
    return f"{name}_" if name in _RESERVED else name


class FunctionTranslator:
    """Translates the body of one Python function to JavaScript.

    Args:
        resolve: Returns the JavaScript expression of a global dotted name, or None for other names.
        bind: Returns the arguments of a call by position, None where one is absent; or None for
            calls whose parameters are not known.
    """

    def __init__(self, resolve: Resolve, bind: Bind) -> None:
        self._resolve, self._bind = resolve, bind
        self._scopes: list[set[str]] = []

    def function(self, node: ast.FunctionDef, name: str, *, method: bool = False) -> str:
        """Return a function definition as JavaScript, without annotations and docstring."""
        arguments = [*node.args.args, *node.args.kwonlyargs]
        positional = len(node.args.args) - len(node.args.defaults)
        defaults = [None] * positional + list(node.args.defaults) + list(node.args.kw_defaults)
        names = {argument.arg for argument in arguments}
        stored = set(_stored(node.body))
        self._scopes = [names | stored]
        parameters = [
            _name(argument.arg) + (f" = {self.value(default)}" if default is not None else "")
            for argument, default in zip(arguments, defaults, strict=True)
        ][1 if method else 0 :]
        local_names = sorted(_name(entry) for entry in stored - names)
        head = "  const self = this;\n" if method else ""
        head += f"  let {', '.join(local_names)};\n" if local_names else ""
        body = self._block(node.body[1:] if ast.get_docstring(node) else node.body)
        star = "*" if _is_generator(node) else ""
        keyword = star if method else f"function{star} "
        return f"{keyword}{name}({', '.join(parameters)}) {{\n{head}{body}}}"

    def _block(self, body: list[ast.stmt]) -> str:
        return "".join(f"{line}\n" for node in body for line in [self._statement(node)] if line)

    def _statement(self, node: ast.stmt) -> str:
        match node:
            case ast.Return(value):
                return f"return {self.value(value)};" if value else "return;"
            case ast.Expr(ast.Yield(ast.expr() as value)):
                return f"yield {self.value(value)};"
            case ast.Expr(ast.YieldFrom(value)):
                return f"yield* py.iter({self.value(value)});"
            case ast.Expr(value):
                return f"{self.value(value)};"
            case ast.Assign(targets, value):
                return "".join(self._assign(target, self.value(value)) for target in targets)
            case ast.AnnAssign(target, _, ast.expr() as value):
                return self._assign(target, self.value(value))
            case ast.AugAssign(target, operator, value):
                return self._assign(target, self.value(ast.BinOp(target, operator, value)))
            case ast.If(test, body, orelse):
                other = f" else {{\n{self._block(orelse)}}}" if orelse else ""
                return f"if ({self.truth(test)}) {{\n{self._block(body)}}}{other}"
            case ast.For(target, iterable, body, []):
                head = f"for ({self._target(target)} of py.iter({self.value(iterable)}))"
                return f"{head} {{\n{self._block(body)}}}"
            case ast.While(test, body, []):
                return f"while ({self.truth(test)}) {{\n{self._block(body)}}}"
            case ast.Try(body, [ast.ExceptHandler(ast.Name(kind), name, handler)], [], []):
                caught = _name(name or "error")
                guard = f"if (!({caught} instanceof {_ERRORS[kind]})) throw {caught};\n"
                handled = f"catch ({caught}) {{\n{guard}{self._block(handler)}}}"
                return f"try {{\n{self._block(body)}}} {handled}"
            case ast.Raise(ast.Call(_, [message, *_])):
                return f"throw new Error({self.value(message)});"
            case ast.Break():
                return "break;"
            case ast.Continue():
                return "continue;"
            case ast.Assert() | ast.Pass() | ast.AnnAssign():
                return ""
        raise Untranslatable(f"line {node.lineno}: {type(node).__name__}")

    def _assign(self, target: ast.expr, value: str) -> str:
        if isinstance(target, ast.Subscript):
            return f"{self.value(target.value)}.set({self.value(target.slice)}, {value});"
        return f"{self._target(target)} = {value};"

    def _target(self, node: ast.expr) -> str:
        if isinstance(node, ast.Name):
            return _name(node.id)
        if isinstance(node, (ast.Tuple, ast.List)):
            return f"[{', '.join(self._target(entry) for entry in node.elts)}]"
        if isinstance(node, ast.Starred):
            return f"...{self._target(node.value)}"
        raise Untranslatable(f"line {node.lineno}: a target {type(node).__name__}")

    def truth(self, node: ast.expr) -> str:
        """Return an expression as a JavaScript condition, with Python's idea of truth."""
        match node:
            case ast.BoolOp(operator, values):
                sign = " && " if isinstance(operator, ast.And) else " || "
                return f"({sign.join(self.truth(value) for value in values)})"
            case ast.UnaryOp(ast.Not(), operand):
                return f"!{self.truth(operand)}"
            case ast.Compare():
                return self.value(node)
            case ast.Call(ast.Name(name)) if name in _YES_OR_NO:
                return self.value(node)
        return f"py.bool({self.value(node)})"

    def value(self, node: ast.expr) -> str:
        """Return a Python expression as JavaScript."""
        match node:
            case ast.Constant(value):
                return literal(value)
            case ast.Name() | ast.Attribute():
                return self._reference(node)
            case ast.JoinedStr(values):
                return f"`{''.join(self._text(value) for value in values)}`"
            case ast.BinOp(left, operator, right) if type(operator) in _OPERATIONS:
                text = _OPERATIONS[type(operator)].format(self.value(left), self.value(right))
                return f"({text})"
            case ast.UnaryOp(ast.Not(), operand):
                return f"!{self.truth(operand)}"
            case ast.UnaryOp(ast.USub(), operand):
                return f"(-{self.value(operand)})"
            case ast.BoolOp(operator, [first, *others]):
                name = "and" if isinstance(operator, ast.And) else "or"
                parts = [self.value(first), *(f"() => {self.value(other)}" for other in others)]
                return f"py.{name}({', '.join(parts)})"
            case ast.Compare(left, operators, others):
                return self._comparison([left, *others], operators)
            case ast.IfExp(test, body, orelse):
                return f"({self.truth(test)} ? {self.value(body)} : {self.value(orelse)})"
            case ast.Subscript(target, ast.Slice(None, None, ast.UnaryOp())):  # [::-1]
                return f"py.list({self.value(target)}).reverse()"
            case ast.Subscript(target, ast.Slice(lower, upper, None)):
                limits = [self.value(part) if part else "null" for part in (lower, upper)]
                return f"py.slice({self.value(target)}, {', '.join(limits)})"
            case ast.Subscript(target, index):
                return f"py.item({self.value(target)}, {self.value(index)})"
            case ast.Tuple(parts) | ast.List(parts):
                return f"[{self._listed(parts)}]"
            case ast.Set(parts):
                return f"py.set([{self._listed(parts)}])"
            case ast.Dict(keys, values):
                pairs = zip(keys, values, strict=True)
                entries = (f"[{self.value(k)}, {self.value(v)}]" for k, v in pairs if k)
                return f"py.dict([{', '.join(entries)}])"
            case ast.ListComp(element, loops) | ast.GeneratorExp(element, loops):
                text = self._comprehension([element], loops)
                return f"[...{text}]" if isinstance(node, ast.ListComp) else text
            case ast.SetComp(element, loops):
                return f"py.set({self._comprehension([element], loops)})"
            case ast.DictComp(key, value, loops):
                return f"py.dict({self._comprehension([key, value], loops)})"
            case ast.Lambda(arguments, body):
                names = {argument.arg for argument in arguments.args}
                self._scopes.append(names)
                text = f"({', '.join(_name(a.arg) for a in arguments.args)}) => {self.value(body)}"
                self._scopes.pop()
                return text
            case ast.Starred(value):
                return f"...py.iter({self.value(value)})"
            case ast.Call():
                return self._call(node)
        raise Untranslatable(f"line {node.lineno}: {ast.unparse(node)}")

    def _reference(self, node: ast.Name | ast.Attribute) -> str:
        resolved = self._global(node)
        if resolved is not None:
            return _VALUES.get(resolved, resolved)
        if isinstance(node, ast.Attribute):
            return f"{self.value(node.value)}.{node.attr}"
        if not any(node.id in scope for scope in self._scopes):
            raise Untranslatable(f"line {node.lineno}: the name {node.id}")
        return _name(node.id)

    def _global(self, node: ast.expr) -> str | None:
        """Return JavaScript for a dotted name of a Python global; None for any other expression."""
        root: ast.expr = node
        while isinstance(root, ast.Attribute):
            root = root.value
        if not isinstance(node, (ast.Name, ast.Attribute)):
            return None
        is_local = isinstance(root, ast.Name) and any(root.id in scope for scope in self._scopes)
        if not isinstance(root, ast.Name) or is_local:
            return None
        return self._resolve(ast.unparse(node))

    def _text(self, node: ast.expr) -> str:
        """Return a part of an f-string as a part of a template literal."""
        if isinstance(node, ast.Constant):
            text = str(node.value).replace("\\", "\\\\").replace("`", "\\`")
            return text.replace("${", "\\${").replace("\n", "\\n")
        assert isinstance(node, ast.FormattedValue)
        value = self.value(node.value)
        if node.conversion == ord("r"):
            value = f"py.repr({value})"
        if node.format_spec is not None:
            return f"${{py.format({value}, {self.value(node.format_spec)})}}"
        return f"${{py.str({value})}}"

    def _comparison(self, operands: list[ast.expr], operators: list[ast.cmpop]) -> str:
        parts = []
        for left, operator, right in zip(operands, operators, operands[1:], strict=False):
            form = _COMPARISONS[type(operator)]
            if isinstance(right, ast.Constant) and right.value is None:
                form = "{0} == null" if isinstance(operator, ast.Is) else "{0} != null"
            parts.append(form.format(self.value(left), self.value(right)))
        return f"({' && '.join(parts)})"

    def _comprehension(self, parts: list[ast.expr], loops: list[ast.comprehension]) -> str:
        """Return a comprehension as a generator that is called at once."""
        head, closing = "", 0
        for loop in loops:
            iterable = self.value(loop.iter)  # outside the scope of its own names
            self._scopes.append(set(_stored([ast.Assign([loop.target], loop.iter)])))
            head += f"for (const {self._target(loop.target)} of py.iter({iterable})) "
            head += "".join(f"if ({self.truth(test)}) " for test in loop.ifs)
            closing += 1
        values = [self.value(part) for part in parts]
        del self._scopes[-closing:]
        element = values[0] if len(values) == 1 else f"[{', '.join(values)}]"
        return f"(function* () {{ {head}yield {element}; }})()"

    def _listed(self, parts: list[ast.expr]) -> str:
        return ", ".join(self.value(part) for part in parts)

    def _call(self, node: ast.Call) -> str:
        target = node.func
        if isinstance(target, ast.Subscript) and ast.unparse(target.value) in _GENERIC:
            target = target.value  # set[str]()
        arguments = self._bind(node) if self._global(target) is not None else None
        if arguments is not None:
            while arguments and arguments[-1] is None:
                arguments.pop()
            texts = ["undefined" if part is None else self.value(part) for part in arguments]
        else:
            # Keywords of Python's own functions: `strict` alone has no counterpart.
            extra = [keyword.value for keyword in node.keywords if keyword.arg != "strict"]
            texts = [self.value(part) for part in (*node.args, *extra)]
        if isinstance(target, ast.Attribute) and self._global(target) is None:
            owner = self.value(target.value)
            if target.attr in _METHODS:
                return _METHODS[target.attr].format(owner, *texts, all=", ".join([owner, *texts]))
            return f"{owner}.{target.attr}({', '.join(texts)})"
        name = self.value(target)
        if name in ("py.min", "py.max") and len(node.args) > 1:
            texts = [f"[{', '.join(texts)}]"]
        if name in _BUILTINS:
            return _BUILTINS[name].format(*texts, "null")
        is_class = name.rpartition(".")[2][:1].isupper()
        return f"{'new ' if is_class else ''}{name}({', '.join(texts)})"


def _stored(body: list[ast.stmt]) -> Iterator[str]:
    """Yield the names that statements assign, without those of comprehensions and lambdas."""
    queue: list[ast.AST] = list(body)
    while queue:
        node = queue.pop()
        if isinstance(
            node, (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp, ast.Lambda)
        ):
            continue
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        if isinstance(node, ast.ExceptHandler) and node.name:
            yield node.name
        queue.extend(ast.iter_child_nodes(node))


def _is_generator(node: ast.FunctionDef) -> bool:
    return any(isinstance(entry, (ast.Yield, ast.YieldFrom)) for entry in ast.walk(node))
