"""The browser's rules and kinds of files: ES modules translated from the contract's functions."""

__all__ = ["NOT_IN_PAGES", "kinds_text", "page_rules", "rules_text"]

import ast
import builtins
import inspect
import json
import re
import textwrap
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass
from types import FunctionType, ModuleType
from typing import Final, get_args, get_type_hints

from gsgen.contract.file_kinds.recognition import RECOGNITION_BYTES, archive_kind, content_kind
from gsgen.contract.model.graph import read_graph
from gsgen.contract.model.inspected_model import InspectedModel
from gsgen.contract.model.manifest_inference import infer_manifest
from gsgen.contract.model.model_file import ModelFile
from gsgen.contract.model.provider_placement import is_copy
from gsgen.contract.rules.catalogue import builtin_rules
from gsgen.contract.spec import manifest_io
from gsgen.contract.spec.fields.roles import MANIFEST_KINDS
from gsgen.contract.spec.targets import Target, load_target
from gsgen.contract.validation.rule import Rule
from web_client.javascript import FunctionTranslator, Untranslatable, literal
from web_client.onnx_messages import message_fields

_INFERENCE: Final = "needs the shapes that ONNX infers"
_FOLDER: Final = "reads files beside the model"
NOT_IN_PAGES: Final[Mapping[str, str]] = {
    "GM025": _FOLDER,
    "GM033": _FOLDER,
    "GS001": _FOLDER,
    "GG019": "is ONNX's own checker",
    **dict.fromkeys(("GG011", "GG014", "GG015", "GG020"), _INFERENCE),
    **dict.fromkeys(("GG004", "GG005", "GG006", "GG007", "GG008", "GG009"), _INFERENCE),
    **dict.fromkeys(("GG017", "GG018", "GG026", "TV109"), _INFERENCE),
    **dict.fromkeys(("GG025", "GI037"), "reads the values of weights"),
    "GI045": "counts in float32 with NumPy",
    "GS002": "plans the runs of the model",
}
"""Static rules that pages do not check, and the reason."""

# Functions whose hints a page leaves out, for those of the rules.
_HINTS: Final = [
    f"gsgen.contract.rules.{name}_hint"
    for name in (
        "graph.capture._passed",
        "graph.graph._lower_opset",
        "graph.naming._clean",
        "interface.avatar_inputs._sound",
        "interface.input_declarations._frames",
        "interface.inputs._baked",
        "interface.inputs._declare",
        "interface.inputs._fit",
        "interface.inputs._other_role",
        "interface.inputs._size",
        "interface.inputs._slider",
        "interface.manifest._schema",
        "interface.manifest._version",
        "outputs.companions._scale",
        "outputs.outputs._count",
        "outputs.outputs._cut",
        "outputs.outputs._role",
        "outputs.outputs._rows",
        "targets.visionary._half",
        "targets.visionary._name",
        "targets.visionary_drawing._srgb",
        "values.cells._count",
        "values.cells._matrix",
    )
]
# Functions that the client has in its own words.
_OVERRIDES: Final = {
    "gsgen.contract.validation.finding.Violation.at": "py.violation",
    "gsgen.contract.spec.manifest_io._published_schema": "publishedSchema",
    "gsgen.contract.spec.fields.json_schema.from_json": "py.fromJson",
    "gsgen.contract.model.graph._infer_facts": "noFacts",
    **dict.fromkeys(_HINTS, "noHint"),
    "gsgen.contract.model.graph._densify_sparse_tensor": "denseWeight",
    "gsgen.contract.file_kinds.text_kinds._decoded": "py.decoded",
    "builtins.int.from_bytes": "py.fromBytes",
    "collections.Counter": "py.counter",
    "itertools.chain": "py.chain",
    "json.loads": "py.loads",
    "json.dumps": "py.dumps",
    "math.isfinite": "Number.isFinite",
    "math.prod": "py.prod",
    "re.search": "py.search",
    "builtins.dict.fromkeys": "py.fromkeys",
}


_FLAGS: Final = {re.IGNORECASE: "i", re.MULTILINE: "m"}

_HEAD: Final = """\
// Written by `make web` from Python functions of the contract; do not edit.
// @ts-nocheck

import * as py from "./python.js";
"""
_PRELUDE: Final = """\
const publishedSchema = (kind) => SCHEMAS.get(kind);
const denseWeight = ({ dims, values: { name, data_type } }) => ({ name, data_type, dims });
const noFacts = () => ({ tensors: new Map(), conflicts: [], checker: "", inference: "" });
const noHint = () => "";
"""


def page_rules() -> list[Rule]:
    """Return the static rules that web pages check, sorted so that a rule follows those that it needs."""
    rules = {
        entry.id: entry
        for entry in builtin_rules()
        if entry.scope == "model" and entry.id not in NOT_IN_PAGES
    }
    ordered: dict[str, Rule] = {}

    def add(entry: Rule) -> None:
        for need in entry.needs:
            if need in rules and need not in ordered:
                add(rules[need])
        ordered.setdefault(entry.id, entry)

    for entry in rules.values():
        add(entry)
    return list(ordered.values())


def rules_text() -> str:
    """Return an ES module: the validation rules with all functions and constants that they use."""
    module = _Module()
    entries = []
    for entry in page_rules():
        facts = {
            "id": entry.id,
            "severity": entry.severity.word,
            "hint": entry.hint,
            "kinds": list(entry.kinds),
            "target": entry.target,
            "limit": entry.limit,
            "needs": list(entry.needs),
        }
        text = json.dumps(facts, ensure_ascii=False)
        entries.append(f"{text[:-1]}, check: {module.reference(entry, entry.slug)}}}")
    targets = ",\n".join(_target(module, entry) for entry in _targets())
    exported = {
        "RULES": "[\n" + ",\n".join(entries) + "\n]",
        "TARGETS": f"py.dict([\n{targets}\n])",
        "MESSAGES": json.dumps(message_fields()),
        "InspectedModel": module.reference(InspectedModel, ""),
        "ModelFile": module.reference(ModelFile, ""),
        "inferManifest": module.reference(infer_manifest, ""),
        "isCopy": module.reference(is_copy, ""),
        "parseManifest": module.reference(manifest_io.parse, ""),
        "readGraph": module.reference(read_graph, ""),
    }
    by_kind = {
        kind: manifest_io.schemas()[manifest_io.schema_name(kind)] for kind in MANIFEST_KINDS
    }
    schemas = json.dumps(json.dumps(by_kind, ensure_ascii=False), ensure_ascii=False)
    module.add_methods()
    return "\n".join(
        [
            _HEAD,
            _PRELUDE,
            *module.classes(),
            *module.functions.values(),
            f"const SCHEMAS = py.loads({schemas});",
            *module.constants.values(),
            *(
                f"/** @type {{any}} */\nexport const {name} = {value};"
                for name, value in exported.items()
            ),
            "",
        ]
    )


def kinds_text() -> str:
    """Return an ES module with the functions that tell the kind of a file from its content."""
    module = _Module()
    exported = {
        "contentKind": module.reference(content_kind, ""),
        "archiveKind": module.reference(archive_kind, ""),
        "RECOGNITION_BYTES": module.reference(RECOGNITION_BYTES, ""),
    }
    module.add_methods()
    return "\n".join(
        [
            _HEAD,
            *module.classes(),
            *module.functions.values(),
            *module.constants.values(),
            *(
                f"/** @type {{any}} */\nexport const {name} = {value};"
                for name, value in exported.items()
            ),
            "",
        ]
    )


def _targets() -> list[Target]:
    return [load_target(name) for name in ("core", "gsgen", "visionary", "webgpu")]


def _target(module: "_Module", target: Target) -> str:
    """Return a playback target (its limits and severities) as an entry of a JavaScript table."""
    words = {id: severity.word for id, severity in target.severities.items()}
    values = [getattr(target, field.name) for field in fields(Target)]
    texts = [module.constant(words if value == target.severities else value) for value in values]
    name = module.reference(Target, "")
    return f"[{literal(target.name)}, new {name}({', '.join(texts)})]"


class _Module:
    """Collects the functions, classes and constants of a JavaScript module translated from Python.

    Attributes:
        functions: Translated functions by the name that they have in JavaScript.
        constants: Definitions of constants, each after those that it refers to.
    """

    def __init__(self) -> None:
        self.functions: dict[str, str] = {}
        self.constants: dict[str, str] = {}
        self._names: dict[int, str] = {}
        self._classes: dict[str, type] = {}
        self._methods: dict[str, dict[str, str]] = {}
        self._words: set[str] = {"__str__"}

    def reference(self, value: object, name: str) -> str:
        """Return the JavaScript expression of a global Python value, and define it if needed."""
        value = value.check if isinstance(value, Rule) else value
        value = inspect.unwrap(value) if callable(value) else value
        override = _OVERRIDES.get(_path(value))
        if override is not None:
            return override
        if isinstance(value, FunctionType):
            return self._function(value)
        if isinstance(value, type):
            return self._class(value)
        if value is None or isinstance(value, (bool, int, float, str, bytes)):
            return literal(value)
        if id(value) not in self._names:
            self._names[id(value)] = f"{name}${len(self._names)}"
            self.constants[self._names[id(value)]] = ""  # its place, should it refer to itself
            text = f"const {self._names[id(value)]} = {self.constant(value)};"
            del self.constants[self._names[id(value)]]
            self.constants[self._names[id(value)]] = text
        return self._names[id(value)]

    def _function(self, function: FunctionType) -> str:
        name = f"{function.__name__}${function.__module__.rpartition('.')[2]}"
        if name not in self.functions:
            self.functions[name] = ""
            tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
            assert isinstance(tree, ast.FunctionDef)
            self.functions[name] = self._translated(function, tree, name)
        return name

    def _translated(
        self, function: FunctionType, tree: ast.FunctionDef, name: str, *, method: bool = False
    ) -> str:
        translator = FunctionTranslator(
            lambda dotted: self._resolved(function, dotted),
            lambda node: self._bound(function, node),
        )
        self._words |= {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        try:
            return translator.function(tree, name, method=method)
        except Untranslatable as error:
            raise Untranslatable(
                f"{function.__module__}.{function.__qualname__}: {error}"
            ) from error

    def _class(self, owner: type) -> str:
        if not is_dataclass(owner):
            raise Untranslatable(f"the class {owner.__qualname__} is not a dataclass")
        name = f"{owner.__name__.lstrip('_')}${owner.__module__.rpartition('.')[2]}"
        self._classes.setdefault(name, owner)
        self._methods.setdefault(name, {})
        return name

    def add_methods(self) -> None:
        """Translate the methods and properties that JavaScript code uses, until all are there."""
        size = -1
        while size != self._size():
            size = self._size()
            for name, owner in list(self._classes.items()):
                for method, member in _members(owner).items():
                    if method in self._words and method not in self._methods[name]:
                        self._methods[name][method] = ""
                        self._methods[name][method] = self._method(method, member)
                for field in fields(owner):
                    self._kind(owner, field)

    def _size(self) -> int:
        methods = sum(len(entry) for entry in self._methods.values())
        return methods + len(self._classes) + len(self.functions)

    def _method(self, name: str, member: object) -> str:
        function = _function_of(member)
        assert function is not None
        tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
        assert isinstance(tree, ast.FunctionDef)
        if member is function:
            return self._translated(function, tree, name, method=True)
        body = self._translated(function, tree, f"_{name}", method=True)
        getter = f"get {name}() {{ return py.cached(this, {literal(name)}, this._{name}); }}"
        return f"{body}\n{getter}"

    def classes(self) -> list[str]:
        """Return the JavaScript definitions of all translated classes."""
        texts = []
        for name, owner in self._classes.items():
            entries = [self._field(owner, field) for field in fields(owner) if field.init]
            body = "\n".join(
                [f"static fields = [{', '.join(entries)}];", *self._methods[name].values()]
            )
            texts.append(f"class {name} extends py.Record {{\n{body}\n}}")
        return texts

    def _field(self, owner: type, field: "Field[object]") -> str:
        kind = self._kind(owner, field)
        default = "null"
        if field.default_factory is not MISSING:
            default = f"() => {self.constant(field.default_factory())}"
        elif field.default is not MISSING and field.default is not None:
            default = f"() => {self.constant(field.default)}"
        return f"[{literal(field.name)}, {f'() => {kind}' if kind else 'null'}, {default}]"

    def _kind(self, owner: type, field: "Field[object]") -> str:
        """Return the JavaScript class of a dataclass field: a record, Number (floats) or empty."""
        leaves = _leaves(get_type_hints(owner)[field.name])
        records = [leaf for leaf in leaves if isinstance(leaf, type) and is_dataclass(leaf)]
        if records and owner.__module__.startswith("gsgen.contract.spec"):
            return self._class(records[0])
        return "Number" if float in leaves else ""

    def constant(self, value: object) -> str:
        """Return a JavaScript expression for Python data: scalars, containers and dataclasses."""
        if isinstance(value, (tuple, list)):
            return f"[{', '.join(self.constant(entry) for entry in value)}]"
        if isinstance(value, dict):
            pairs = (f"[{self.constant(k)}, {self.constant(v)}]" for k, v in value.items())
            return f"py.dict([{', '.join(pairs)}])"
        if isinstance(value, (set, frozenset)):
            return f"py.set([{', '.join(self.constant(entry) for entry in sorted(value))}])"
        if isinstance(value, re.Pattern):
            flags = "".join(letter for flag, letter in _FLAGS.items() if value.flags & flag)
            return f"new RegExp({literal(value.pattern)}, {literal(flags)})"
        if is_dataclass(value) and not isinstance(value, type):
            parts = [self.constant(getattr(value, field.name)) for field in fields(value)]
            return f"new {self._class(type(value))}({', '.join(parts)})"
        if callable(value):
            return self.reference(value, "")
        return literal(value)

    def _resolved(self, function: FunctionType, dotted: str) -> str | None:
        root, *attributes = dotted.split(".")
        if root in function.__globals__:
            value = function.__globals__[root]
        elif hasattr(builtins, root):
            if not attributes:
                return f"py.{root}"
            value = getattr(builtins, root)
        else:
            return None
        for attribute in attributes:
            if not isinstance(value, (ModuleType, type)):
                return None
            value = getattr(value, attribute)
        return self.reference(value, dotted.rpartition(".")[2])

    def _bound(self, function: FunctionType, node: ast.Call) -> list[ast.expr | None] | None:
        """Return a Python call's arguments in parameter order; None if the order is unknown."""
        if any(isinstance(argument, ast.Starred) for argument in node.args):
            return list(node.args) if not node.keywords else None
        dotted = ast.unparse(node.func)
        root, *attributes = dotted.split(".")
        value = function.__globals__.get(root)
        for attribute in attributes:
            if not isinstance(value, (ModuleType, type)):
                return None
            value = getattr(value, attribute)
        if isinstance(value, Rule):
            value = value.check
        module = getattr(value, "__module__", None) or ""
        if not callable(value) or not module.startswith("gsgen."):
            return None
        names = list(inspect.signature(value).parameters)
        arguments: dict[str, ast.expr | None] = dict.fromkeys(names)
        arguments |= dict(zip(names, node.args, strict=False))
        arguments |= {keyword.arg or "": keyword.value for keyword in node.keywords}
        return list(arguments.values())


def _path(value: object) -> str:
    """Return the module and the qualified name of a function or class; empty for others."""
    module = getattr(value, "__module__", None) or "builtins"
    return f"{module}.{getattr(value, '__qualname__', '')}"


def _members(owner: type) -> dict[str, object]:
    """Return the functions and properties of a class and of its bases, written in Python."""
    members: dict[str, object] = {}
    for base in reversed(owner.__mro__):
        for name, value in vars(base).items():
            function = _function_of(value)
            # Those of `dataclass` have no file.
            if function is not None and not function.__code__.co_filename.startswith("<"):
                members[name] = value
    return members


def _function_of(member: object) -> FunctionType | None:
    """Return the function of a method or property; None for other members."""
    function = getattr(member, "fget", None) or getattr(member, "func", None) or member
    return function if isinstance(function, FunctionType) else None


def _leaves(hint: object) -> list[object]:
    """Return the innermost types of a type annotation: str and int for ``dict[str, int]``."""
    parts = get_args(hint)
    return [leaf for part in parts for leaf in _leaves(part)] if parts else [hint]
