"""Interprets a pickle as plain data, without calling any code and without building any object.

A pickle is a program for a stack machine that can call any function by name. This interpreter
knows containers, numbers, texts and tensors; any other object becomes an :class:`Opaque` record of
what would be called. `pickle.Unpickler` with a list of allowed names does less: a pickle of nine
bytes can make its memo take gigabytes, and a NumPy dtype that sets its own state crashes Python.
"""

__all__ = ["OpaqueObject", "Storage", "TensorReference", "pickled_data"]

import codecs
import io
import operator
import pickletools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, final

_DTYPE_BY_STORAGE = {
    "FloatStorage": "float32", "DoubleStorage": "float64", "HalfStorage": "float16",
    "BFloat16Storage": "bfloat16", "LongStorage": "int64", "IntStorage": "int32",
    "ShortStorage": "int16", "CharStorage": "int8", "ByteStorage": "uint8", "BoolStorage": "bool",
}  # fmt: skip


@final
@dataclass(slots=True, eq=False)
class OpaqueObject:
    """A Python class, function or object that a pickle names, which is left uninterpreted."""

    name: str
    # Those of the call that would make the object; None for a bare name. Not in the text, which
    # would be endless where few objects share each other.
    arguments: Any = field(default=None, repr=False)
    state: Any = field(default=None, repr=False)  # what the object's attributes would be set from


@final
@dataclass(frozen=True, slots=True)
class Storage:
    """A reference to the stored numbers of tensors; ``dtype`` is empty if it is unknown."""

    key: str
    dtype: str


@final
@dataclass(frozen=True, slots=True)
class TensorReference:
    """A tensor that is still in the file; its offset and strides count elements."""

    storage: Storage
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


@final
class _PickleMachine:
    """The state of the pickle interpreter: stack, marks and memo."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memoized: dict[int, Any] = {}
        self._mark_offsets: list[int] = []

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def mark(self) -> None:
        self._mark_offsets.append(len(self.stack))

    def pop_to_mark(self) -> list[Any]:
        start = self._mark_offsets.pop()
        items = self.stack[start:]
        del self.stack[start:]
        return items

    def pop_many(self, count: int) -> list[Any]:
        if count > len(self.stack):
            raise ValueError("the pickle pops more values than it has pushed")
        items = self.stack[len(self.stack) - count :]
        del self.stack[len(self.stack) - count :]
        return items

    def memoize(self, index: int) -> None:
        self.memoized[index] = self.stack[-1]

    def extend(self, items: list[Any]) -> None:
        if isinstance(self.stack[-1], list):
            self.stack[-1].extend(items)

    def update(self, items: list[Any]) -> None:
        if isinstance(self.stack[-1], dict):
            self.stack[-1].update(_dict_from_pairs(items))

    def call_function(self) -> None:
        function, arguments = self.pop_many(2)
        is_class_name = isinstance(function, OpaqueObject) and function.arguments is None
        self.push(_build_object(function.name if is_class_name else "", arguments))

    def set_state(self) -> None:
        (state,) = self.pop_many(1)
        if isinstance(self.stack[-1], OpaqueObject):
            self.stack[-1].state = state

    def load_persistent(self) -> None:
        """Push the storage that a pickle's persistent id names: class, key, device and count."""
        (_, kind, key, *_), *_ = self.pop_many(1)
        if not isinstance(key, str | int):
            raise TypeError("the pickle names stored numbers by neither a text nor a number")
        self.push(Storage(str(key), _DTYPE_BY_STORAGE.get(kind.name.rpartition(".")[2], "")))


def _dict_from_pairs(items: list[Any]) -> dict[Any, Any]:
    """Return keys and values, which alternate in a pickle, as a dict."""
    for key in items[::2]:
        # Python's hash of a tuple overflows the stack if tuples are nested a million deep.
        if isinstance(key, tuple) and any(isinstance(part, tuple) for part in key):
            raise TypeError("a key in the pickle is a tuple of tuples, expected a name or a number")
    return dict(zip(items[::2], items[1::2], strict=True))


def _build_object(name: str, arguments: Any) -> Any:
    """Return plain data in place of the object that a call in a pickle would create."""
    if name == "collections.OrderedDict":
        return {}
    if name == "torch._utils._rebuild_parameter":
        return arguments[0]
    if name != "torch._utils._rebuild_tensor_v2":
        return OpaqueObject(name, arguments)
    storage, offset, shape, strides, *_ = arguments
    sizes = (offset, *shape, *strides)
    if not isinstance(storage, Storage) or any(type(size) is not int or size < 0 for size in sizes):
        raise ValueError(
            "a tensor in the pickle has no storage, or a size that is not a whole number"
        )
    return TensorReference(storage, offset, tuple(shape), tuple(strides))


_INSTRUCTION_BY_CODE = {instruction.code: instruction for instruction in pickletools.opcodes}
_OPCODE_ACTIONS: dict[str, Callable[[_PickleMachine, Any], object]] = {
    "PROTO": lambda machine, _: None,
    "FRAME": lambda machine, _: None,
    "MARK": lambda machine, _: machine.mark(),
    "POP": lambda machine, _: machine.pop_many(1),
    "POP_MARK": lambda machine, _: machine.pop_to_mark(),
    "DUP": lambda machine, _: machine.push(machine.stack[-1]),
    "NONE": lambda machine, _: machine.push(None),
    "NEWTRUE": lambda machine, _: machine.push(True),
    "NEWFALSE": lambda machine, _: machine.push(False),
    "EMPTY_DICT": lambda machine, _: machine.push({}),
    "EMPTY_LIST": lambda machine, _: machine.push([]),
    "EMPTY_TUPLE": lambda machine, _: machine.push(()),
    "EMPTY_SET": lambda machine, _: machine.push(set()),
    "DICT": lambda machine, _: machine.push(_dict_from_pairs(machine.pop_to_mark())),
    "LIST": lambda machine, _: machine.push(machine.pop_to_mark()),
    "TUPLE": lambda machine, _: machine.push(tuple(machine.pop_to_mark())),
    "TUPLE1": lambda machine, _: machine.push(tuple(machine.pop_many(1))),
    "TUPLE2": lambda machine, _: machine.push(tuple(machine.pop_many(2))),
    "TUPLE3": lambda machine, _: machine.push(tuple(machine.pop_many(3))),
    "APPEND": lambda machine, _: machine.extend(machine.pop_many(1)),
    "APPENDS": lambda machine, _: machine.extend(machine.pop_to_mark()),
    "ADDITEMS": lambda machine, _: machine.pop_to_mark(),  # sets are not needed
    "SETITEM": lambda machine, _: machine.update(machine.pop_many(2)),
    "SETITEMS": lambda machine, _: machine.update(machine.pop_to_mark()),
    "GLOBAL": lambda machine, name: machine.push(OpaqueObject(name.replace(" ", "."))),
    "STACK_GLOBAL": lambda machine, _: machine.push(OpaqueObject(".".join(machine.pop_many(2)))),
    "BINPERSID": lambda machine, _: machine.load_persistent(),
    "REDUCE": lambda machine, _: machine.call_function(),
    "NEWOBJ": lambda machine, _: machine.call_function(),
    "BUILD": lambda machine, _: machine.set_state(),
    "MEMOIZE": lambda machine, _: machine.memoize(len(machine.memoized)),
    **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT"), _PickleMachine.memoize),
    **dict.fromkeys(
        ("GET", "BINGET", "LONG_BINGET"),
        lambda machine, index: machine.push(operator.getitem(machine.memoized, index)),
    ),
    **dict.fromkeys(
        (
            *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4"),
            *("FLOAT", "BINFLOAT", "STRING", "BINSTRING", "SHORT_BINSTRING"),
            *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
            *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
        ),
        _PickleMachine.push,
    ),
}


def pickled_data(content: bytes) -> Any:
    """Return the data of a pickle; tensors become references, and other objects records.

    Texts of Python 2 are decoded as Latin-1, so that each character is a byte.

    Raises:
        ValueError: The pickle is damaged, or has an instruction that is not supported.
        LookupError: It takes a value that it has not pushed or stored.
        TypeError: It uses a value of the wrong kind, such as a list as a key.
    """
    machine = _PickleMachine()
    stream = io.BytesIO(content)
    while code := stream.read(1):
        instruction = _INSTRUCTION_BY_CODE.get(code.decode("latin1"))
        name = f"{code!r}" if instruction is None else instruction.name
        if name == "STOP":
            return machine.pop_many(1)[0]
        if instruction is None or name not in _OPCODE_ACTIONS:
            raise ValueError(f"the instruction {name} of the pickle is not supported")
        _OPCODE_ACTIONS[name](machine, _read_argument(instruction, stream))
    raise ValueError("the pickle ends without a STOP instruction")


def _read_argument(instruction: pickletools.OpcodeInfo, stream: io.BytesIO) -> Any:
    if instruction.name == "STRING":  # pickletools reads ASCII alone
        raw = pickletools.read_stringnl(stream, decode=False)
        return codecs.escape_decode(raw)[0].decode("latin1")
    return None if instruction.arg is None else instruction.arg.reader(stream)
