"""Interprets the pickle of a ``torch.save`` file as plain data, without calling any code.

A pickle is a program for a stack machine that can call any function by name. This interpreter
knows containers, numbers, texts and tensors; any other object becomes an :class:`Opaque` name.
"""

__all__ = ["Opaque", "Storage", "TensorReference", "pickled_data"]

import operator
import pickletools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, final

_STORAGES = {
    "FloatStorage": "float32", "DoubleStorage": "float64", "HalfStorage": "float16",
    "BFloat16Storage": "bfloat16",
}  # fmt: skip


@final
@dataclass(frozen=True, slots=True)
class Opaque:
    """A Python class, function or object that a pickle names, which is left uninterpreted."""

    name: str


@final
@dataclass(frozen=True, slots=True)
class Storage:
    """A reference to the stored numbers of tensors; ``dtype`` is empty unless they are floats."""

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

    def extend(self, items: list[Any]) -> None:
        if isinstance(self.stack[-1], list):
            self.stack[-1].extend(items)

    def update(self, items: list[Any]) -> None:
        if isinstance(self.stack[-1], dict):
            self.stack[-1].update(zip(items[::2], items[1::2], strict=True))

    def call(self) -> None:
        function, arguments = self.popped(2)
        name = function.name if isinstance(function, Opaque) else ""
        self.stack.append(_object_of(name, arguments))

    def refer(self) -> None:
        """Push the storage that a pickle's persistent id names: class, key, device and count."""
        (_, kind, key, *_), *_ = self.popped(1)
        self.stack.append(Storage(str(key), _STORAGES.get(kind.name.rpartition(".")[2], "")))


def _object_of(name: str, arguments: Any) -> Any:
    """Return plain data in place of the object that a call in a pickle would create."""
    if name == "collections.OrderedDict":
        return {}
    if name == "torch._utils._rebuild_parameter":
        return arguments[0]
    if name != "torch._utils._rebuild_tensor_v2":
        return Opaque(name)
    storage, offset, shape, strides, *_ = arguments
    sizes = (offset, *shape, *strides)
    if not isinstance(storage, Storage) or any(type(size) is not int or size < 0 for size in sizes):
        raise ValueError(
            "a tensor in the pickle has no storage, or a size that is not a whole number"
        )
    return TensorReference(storage, offset, tuple(shape), tuple(strides))


_ACTIONS: dict[str, Callable[[_Machine, Any], object]] = {
    "PROTO": lambda machine, _: None,
    "FRAME": lambda machine, _: None,
    "MARK": lambda machine, _: machine.mark(),
    "POP": lambda machine, _: machine.popped(1),
    "POP_MARK": lambda machine, _: machine.popped_to_mark(),
    "DUP": lambda machine, _: machine.stack.append(machine.stack[-1]),
    "NONE": lambda machine, _: machine.stack.append(None),
    "NEWTRUE": lambda machine, _: machine.stack.append(True),
    "NEWFALSE": lambda machine, _: machine.stack.append(False),
    "EMPTY_DICT": lambda machine, _: machine.stack.append({}),
    "EMPTY_LIST": lambda machine, _: machine.stack.append([]),
    "EMPTY_TUPLE": lambda machine, _: machine.stack.append(()),
    "TUPLE": lambda machine, _: machine.stack.append(tuple(machine.popped_to_mark())),
    "TUPLE1": lambda machine, _: machine.stack.append(tuple(machine.popped(1))),
    "TUPLE2": lambda machine, _: machine.stack.append(tuple(machine.popped(2))),
    "TUPLE3": lambda machine, _: machine.stack.append(tuple(machine.popped(3))),
    "APPEND": lambda machine, _: machine.extend(machine.popped(1)),
    "APPENDS": lambda machine, _: machine.extend(machine.popped_to_mark()),
    "SETITEM": lambda machine, _: machine.update(machine.popped(2)),
    "SETITEMS": lambda machine, _: machine.update(machine.popped_to_mark()),
    "GLOBAL": lambda machine, name: machine.stack.append(Opaque(name.replace(" ", "."))),
    "STACK_GLOBAL": lambda machine, _: machine.stack.append(
        Opaque(".".join(map(str, machine.popped(2))))
    ),
    "BINPERSID": lambda machine, _: machine.refer(),
    "REDUCE": lambda machine, _: machine.call(),
    "NEWOBJ": lambda machine, _: machine.call(),
    "BUILD": lambda machine, _: machine.popped(1),  # attributes of objects are not needed
    "MEMOIZE": lambda machine, _: operator.setitem(
        machine.memo, len(machine.memo), machine.stack[-1]
    ),
}
_CONSTANTS = frozenset(
    [
        "BININT",
        "BININT1",
        "BININT2",
        "LONG1",
        "LONG4",
        "BINFLOAT",
        "BINUNICODE",
        "SHORT_BINUNICODE",
        "BINBYTES",
        "SHORT_BINBYTES",
        "BINSTRING",
        "SHORT_BINSTRING",
    ]
)


def pickled_data(content: bytes) -> Any:
    """Return the data of a pickle; tensors become references, and other objects their names.

    Raises:
        ValueError: The pickle is damaged, or has an instruction that torch.save does not write.
        LookupError: It takes a value that it has not pushed or stored.
        TypeError: It uses a value of the wrong kind, such as a list as a key.
    """
    machine = _Machine()
    argument: Any
    for code, argument, _ in pickletools.genops(content):
        if code.name == "STOP":
            return machine.popped(1)[0]
        if code.name in _CONSTANTS:
            machine.stack.append(argument)
        elif code.name in ("BINPUT", "LONG_BINPUT"):
            machine.memo[argument] = machine.stack[-1]
        elif code.name in ("BINGET", "LONG_BINGET"):
            machine.stack.append(machine.memo[argument])
        elif code.name in _ACTIONS:
            _ACTIONS[code.name](machine, argument)
        else:
            raise ValueError(f"the instruction {code.name} of the pickle is not supported")
    raise ValueError("the pickle ends without a STOP instruction")
