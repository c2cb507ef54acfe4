"""Interprets a pickle as plain data, without calling any code and without building any object.

A pickle is a program for a stack machine that can call any function by name. This interpreter
knows containers, numbers, texts and tensors; any other object becomes an :class:`Opaque` record of
what would be called. `pickle.Unpickler` with a list of allowed names does less: a pickle of nine
bytes can make its memo take gigabytes, and a NumPy dtype that sets its own state crashes Python.
"""

__all__ = ["Opaque", "Storage", "TensorReference", "pickled_data"]

import codecs
import io
import operator
import pickletools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

_STORAGES = {
    "FloatStorage": "float32", "DoubleStorage": "float64", "HalfStorage": "float16",
    "BFloat16Storage": "bfloat16", "LongStorage": "int64", "IntStorage": "int32",
    "ShortStorage": "int16", "CharStorage": "int8", "ByteStorage": "uint8", "BoolStorage": "bool",
}  # fmt: skip


@final
@dataclass(slots=True, eq=False)
class Opaque:
    """A Python class, function or object that a pickle names, which is left uninterpreted."""

    name: str
    arguments: Any = None  # those of the call that would make the object; None for a bare name
    state: Any = None  # what the object's attributes would be set from


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
class _Machine:
    """The state of the pickle interpreter: stack, marks and memo."""

    def __init__(self) -> None:
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}
        self._marks: list[int] = []

    def push(self, value: Any) -> None:
        self.stack.append(value)

    def mark(self) -> None:
        self._marks.append(len(self.stack))

    def popped_to_mark(self) -> list[Any]:
        start = self._marks.pop()
        items = self.stack[start:]
        del self.stack[start:]
        return items

    def popped(self, count: int) -> list[Any]:
        if count > len(self.stack):
            raise ValueError("the pickle pops more values than it has pushed")
        items = self.stack[len(self.stack) - count :]
        del self.stack[len(self.stack) - count :]
        return items

    def store(self, index: int) -> None:
        self.memo[index] = self.stack[-1]

    def extend(self, items: list[Any]) -> None:
        if isinstance(self.stack[-1], list):
            self.stack[-1].extend(items)

    def update(self, items: list[Any]) -> None:
        if isinstance(self.stack[-1], dict):
            self.stack[-1].update(_paired(items))

    def call(self) -> None:
        function, arguments = self.popped(2)
        is_name = isinstance(function, Opaque) and function.arguments is None
        self.push(_object_of(function.name if is_name else "", arguments))

    def set_state(self) -> None:
        (state,) = self.popped(1)
        if isinstance(self.stack[-1], Opaque):
            self.stack[-1].state = state

    def refer(self) -> None:
        """Push the storage that a pickle's persistent id names: class, key, device and count."""
        (_, kind, key, *_), *_ = self.popped(1)
        if not isinstance(key, str | int):
            raise TypeError("the pickle names stored numbers by neither a text nor a number")
        self.push(Storage(str(key), _STORAGES.get(kind.name.rpartition(".")[2], "")))


def _paired(items: list[Any]) -> dict[Any, Any]:
    """Return keys and values, which alternate in a pickle, as a dict."""
    for key in items[::2]:
        # Python's hash of a tuple overflows the stack if tuples are nested a million deep.
        if isinstance(key, tuple) and any(isinstance(part, tuple) for part in key):
            raise TypeError("a key in the pickle is a tuple of tuples, expected a name or a number")
    return dict(zip(items[::2], items[1::2], strict=True))


def _object_of(name: str, arguments: Any) -> Any:
    """Return plain data in place of the object that a call in a pickle would create."""
    if name == "collections.OrderedDict":
        return {}
    if name == "torch._utils._rebuild_parameter":
        return arguments[0]
    if name != "torch._utils._rebuild_tensor_v2":
        return Opaque(name, arguments)
    storage, offset, shape, strides, *_ = arguments
    sizes = (offset, *shape, *strides)
    if not isinstance(storage, Storage) or any(type(size) is not int or size < 0 for size in sizes):
        raise ValueError(
            "a tensor in the pickle has no storage, or a size that is not a whole number"
        )
    return TensorReference(storage, offset, tuple(shape), tuple(strides))


_INSTRUCTIONS = {instruction.code: instruction for instruction in pickletools.opcodes}
_ACTIONS: dict[str, Callable[[_Machine, Any], object]] = {
    "PROTO": lambda machine, _: None,
    "FRAME": lambda machine, _: None,
    "MARK": lambda machine, _: machine.mark(),
    "POP": lambda machine, _: machine.popped(1),
    "POP_MARK": lambda machine, _: machine.popped_to_mark(),
    "DUP": lambda machine, _: machine.push(machine.stack[-1]),
    "NONE": lambda machine, _: machine.push(None),
    "NEWTRUE": lambda machine, _: machine.push(True),
    "NEWFALSE": lambda machine, _: machine.push(False),
    "EMPTY_DICT": lambda machine, _: machine.push({}),
    "EMPTY_LIST": lambda machine, _: machine.push([]),
    "EMPTY_TUPLE": lambda machine, _: machine.push(()),
    "EMPTY_SET": lambda machine, _: machine.push(set()),
    "DICT": lambda machine, _: machine.push(_paired(machine.popped_to_mark())),
    "LIST": lambda machine, _: machine.push(machine.popped_to_mark()),
    "TUPLE": lambda machine, _: machine.push(tuple(machine.popped_to_mark())),
    "TUPLE1": lambda machine, _: machine.push(tuple(machine.popped(1))),
    "TUPLE2": lambda machine, _: machine.push(tuple(machine.popped(2))),
    "TUPLE3": lambda machine, _: machine.push(tuple(machine.popped(3))),
    "APPEND": lambda machine, _: machine.extend(machine.popped(1)),
    "APPENDS": lambda machine, _: machine.extend(machine.popped_to_mark()),
    "ADDITEMS": lambda machine, _: machine.popped_to_mark(),  # sets are not needed
    "SETITEM": lambda machine, _: machine.update(machine.popped(2)),
    "SETITEMS": lambda machine, _: machine.update(machine.popped_to_mark()),
    "GLOBAL": lambda machine, name: machine.push(Opaque(name.replace(" ", "."))),
    "STACK_GLOBAL": lambda machine, _: machine.push(Opaque(".".join(machine.popped(2)))),
    "BINPERSID": lambda machine, _: machine.refer(),
    "REDUCE": lambda machine, _: machine.call(),
    "NEWOBJ": lambda machine, _: machine.call(),
    "BUILD": lambda machine, _: machine.set_state(),
    "MEMOIZE": lambda machine, _: machine.store(len(machine.memo)),
    **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT"), _Machine.store),
    **dict.fromkeys(
        ("GET", "BINGET", "LONG_BINGET"),
        lambda machine, index: machine.push(operator.getitem(machine.memo, index)),
    ),
    **dict.fromkeys(
        (
            *("INT", "BININT", "BININT1", "BININT2", "LONG", "LONG1", "LONG4"),
            *("FLOAT", "BINFLOAT", "STRING", "BINSTRING", "SHORT_BINSTRING"),
            *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8"),
            *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8"),
        ),
        _Machine.push,
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
    machine = _Machine()
    stream = io.BytesIO(content)
    while code := stream.read(1):
        instruction = _INSTRUCTIONS.get(code.decode("latin1"))
        name = f"{code!r}" if instruction is None else instruction.name
        if name == "STOP":
            return machine.popped(1)[0]
        if instruction is None or name not in _ACTIONS:
            raise ValueError(f"the instruction {name} of the pickle is not supported")
        _ACTIONS[name](machine, _argument(instruction, stream))
    raise ValueError("the pickle ends without a STOP instruction")


def _argument(instruction: pickletools.OpcodeInfo, stream: io.BytesIO) -> Any:
    if instruction.name == "STRING":  # pickletools reads ASCII alone
        raw = pickletools.read_stringnl(stream, decode=False)
        return codecs.escape_decode(raw)[0].decode("latin1")
    return None if instruction.arg is None else instruction.arg.reader(stream)
