"""TorchScript archives whose few bytes stand for graphs without end."""

import zipfile
from collections.abc import Callable
from pathlib import Path

DOUBLINGS = 40
DEPTH = 20_000
_MODULE = b"c__torch__.M\nM\n)\x81"


def _text(words: str) -> bytes:
    return b"X" + len(words).to_bytes(4, "little") + words.encode()


def _put(index: int) -> bytes:
    return b"r" + index.to_bytes(4, "little")


def _get(index: int) -> bytes:
    return b"j" + index.to_bytes(4, "little")


def _int(number: int) -> bytes:
    size = number.bit_length() // 8 + 1
    return b"\x8a" + bytes([size]) + number.to_bytes(size, "little", signed=True)


def _with_state(state: bytes, module: bytes = _MODULE) -> bytes:
    return module + b"}" + state + b"b"


def _tensor(key: str, numbers: int, shape: bytes, strides: bytes, offset: int = 0) -> bytes:
    storage = (
        b"(" + _text("storage") + b"ctorch\nFloatStorage\n" + _text(key) + _text("cpu")
        + _int(numbers) + b"tQ"
    )  # fmt: skip
    return (
        b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + _int(offset) + shape + strides
        + b"\x89}tR"
    )  # fmt: skip


def _shared_modules() -> bytes:
    inner = _with_state(b"")
    for index in range(DOUBLINGS):
        state = _text("a") + _get(index) + b"s" + _text("b") + _get(index) + b"s"
        inner += _put(index) + b"0" + _with_state(state)
    return inner


def _shared_by_lists(kind: bytes) -> bytes:
    """Lists or tuples that hold the last one twice."""
    inner = b")" if kind == b"\x86" else b"]"
    for index in range(DOUBLINGS):
        twice = _get(index) * 2
        inner += _put(index) + b"0" + (twice + kind if kind == b"\x86" else b"](" + twice + b"e")
    return _with_state(_text("a") + inner + b"s")


def _shared_dicts() -> bytes:
    inner = b"}"
    for index in range(DOUBLINGS):
        pairs = _text("a") + _get(index) + _text("b") + _get(index)
        inner += _put(index) + b"0}(" + pairs + b"u"
    return _with_state(_text("a") + inner + b"s")


def _key_of_shared_tuples() -> bytes:
    """A key is an object whose arguments are doubled; its text would be endless."""
    inner = b")"
    for index in range(DOUBLINGS):
        inner += _put(index) + b"0" + _get(index) * 2 + b"\x86"
    key = b"c__torch__.K\nK\n" + inner + b"\x81"
    return _with_state(key + _MODULE + b"s")


def _key_of_one_shared_tuple() -> bytes:
    inner = b")"
    for index in range(DOUBLINGS):
        inner += _put(index) + b"0" + _get(index) * 2 + b"\x86"
    return _with_state(inner + _MODULE + b"s")


def _name_of_shared_tuples() -> bytes:
    """The class is named by an object, not by a text."""
    inner = b")"
    for index in range(DOUBLINGS):
        inner += _put(index) + b"0" + _get(index) * 2 + b"\x86"
    return inner + _text("M") + b"\x93)\x81}b"


def _itself() -> bytes:
    return _MODULE + _put(0) + b"}" + _text("a") + _get(0) + b"sb"


def _cycle() -> bytes:
    """Two modules hold each other."""
    inner = _MODULE + _put(1) + b"}" + _text("b") + _get(0) + b"sb"
    return _MODULE + _put(0) + b"}" + _text("a") + inner + b"sb"


def _deep_modules() -> bytes:
    inner = _with_state(b"")
    for _ in range(DEPTH):
        inner = inner + _put(0) + b"0" + _with_state(_text("a") + _get(0) + b"s")
    return inner


def _deep_states() -> bytes:
    """Every state is set to the object before it."""
    return _MODULE + (_put(0) + b"0" + _MODULE + _get(0) + b"b") * DEPTH


def _huge_storage() -> bytes:
    shape = _int(1 << 40) + b"\x85"
    return _with_state(_text("w") + _tensor("0", 1 << 40, shape, _int(1) + b"\x85") + b"s")


def _strides_of_zero() -> bytes:
    shape = _int(1 << 20) + _int(1 << 20) + b"\x86"
    return _with_state(_text("w") + _tensor("0", 256, shape, _int(0) + _int(0) + b"\x86") + b"s")


def _many_names_of_one_tensor() -> bytes:
    """A hundred thousand names of one tensor, which is as large as the file."""
    shape = _int(250_000) + b"\x85"
    first = _text("w0") + _tensor("0", 250_000, shape, _int(1) + b"\x85") + _put(0) + b"s"
    rest = b"".join(_text(f"w{number}") + _get(0) + b"s" for number in range(1, 100_000))
    return _with_state(first + rest)


def views_of_one_storage(count: int, length: int, step: int, total: int) -> bytes:
    """Return the pickle of a module of tensors w0, w1, … that are parts of one storage."""
    state = b""
    for number in range(count):
        shape = _int(length) + b"\x85"
        state += _text(f"w{number}")
        state += _tensor("0", total, shape, _int(1) + b"\x85", number * step) + b"s"
    return _with_state(state)


def _no_state() -> bytes:
    return _MODULE


def _state_is_a_tensor() -> bytes:
    shape = _int(4) + b"\x85"
    return _MODULE + _tensor("0", 4, shape, _int(1) + b"\x85") + b"b"


SCRIPTS: dict[str, tuple[Callable[[], bytes], int]] = {
    "modules shared 2⁴⁰ times": (_shared_modules, 0),
    "tuples shared 2⁴⁰ times": (lambda: _shared_by_lists(b"\x86"), 0),
    "lists shared 2⁴⁰ times": (lambda: _shared_by_lists(b"e"), 0),
    "dicts shared 2⁴⁰ times": (_shared_dicts, 0),
    "an object as a key, of shared tuples": (_key_of_shared_tuples, 0),
    "a key of shared tuples": (_key_of_one_shared_tuple, 0),
    "a name of shared tuples": (_name_of_shared_tuples, 0),
    "a module in itself": (_itself, 0),
    "two modules in each other": (_cycle, 0),
    "modules nested 20,000 deep": (_deep_modules, 0),
    "states nested 20,000 deep": (_deep_states, 0),
    "a storage of four terabytes": (_huge_storage, 1024),
    "a tensor of strides of zero": (_strides_of_zero, 1024),
    "100,000 names of one tensor": (_many_names_of_one_tensor, 1_000_000),
    "3,000 views of one storage": (
        lambda: views_of_one_storage(3000, 240_000, 1, 250_000),
        1_000_000,
    ),
    "a module without state": (_no_state, 0),
    "a tensor as the state": (_state_is_a_tensor, 16),
}
"""What it does → the pickle of the module, and the bytes of the storage `0`."""


def write_script(folder: Path, name: str) -> Path:
    """Write one of the TorchScript archives."""
    pickle, storage_bytes = SCRIPTS[name]
    return write_module(folder / "net.pt", pickle(), bytes(storage_bytes))


def write_module(path: Path, pickle: bytes, storage: bytes) -> Path:
    """Write a TorchScript archive of the pickle of a module and of the storage `0`."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("net/data.pkl", b"\x80\x02" + pickle + b".")
        archive.writestr("net/constants.pkl", b"\x80\x02).")
        archive.writestr("net/data/0", storage)
    return path
