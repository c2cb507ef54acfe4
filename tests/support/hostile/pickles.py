"""Pickles that build what NumPy cannot hold, call code, or stand for more than memory holds."""

import pickle
import pickletools
from collections.abc import Callable
from pathlib import Path

import numpy as np

PROTOCOL = b"\x80\x04"
DOUBLINGS = 40
DEPTH = 100_000
_ARRAY = b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\nK\x00\x85C\x01bt"
_DTYPE = b"cnumpy\ndtype\n"


def text(words: str) -> bytes:
    """The opcodes that push a text."""
    return b"X" + len(words.encode()).to_bytes(4, "little") + words.encode()


def raw(content: bytes) -> bytes:
    """The opcodes that push bytes."""
    return b"B" + len(content).to_bytes(4, "little") + content


def put(index: int) -> bytes:
    """The opcode that stores the topmost value."""
    return b"r" + index.to_bytes(4, "little")


def get(index: int) -> bytes:
    """The opcode that pushes a stored value."""
    return b"j" + index.to_bytes(4, "little")


def dtype_with(code: str, state: bytes) -> bytes:
    """A dtype that is made from a code and set to a state."""
    return _DTYPE + text(code) + b"\x89\x88\x87R" + state + b"b"


def array_with(dtype: bytes, shape: bytes = b"K\x04\x85", data: bytes = raw(bytes(32))) -> bytes:
    """An array that is set to a state of these parts."""
    return array_set_to(b"(K\x01" + shape + dtype + b"\x89" + data + b"t")


def array_set_to(state: bytes) -> bytes:
    """An array that is set to a state."""
    return _ARRAY + b"R" + state + b"b"


def of_x(value: bytes) -> bytes:
    """A pickle of a dict with the one entry ``x``."""
    return PROTOCOL + b"}" + text("x") + value + b"s."


def state_of(flags: int, byteorder: str = "|", names: bytes = b"N") -> bytes:
    """The state of a dtype with these flags; 63 are those of objects."""
    numbers = b"J\xff\xff\xff\xffJ\xff\xff\xff\xff" + b"K" + bytes([flags])
    return b"(K\x03" + text(byteorder) + b"N" + names + b"N" + numbers + b"t"


def _call(module: str, name: str, arguments: bytes) -> bytes:
    return f"c{module}\n{name}\n".encode() + arguments + b"R"


def _doubled(kind: bytes) -> bytes:
    inner = b")" if kind == b"\x86" else b"]"
    for index in range(DOUBLINGS):
        twice = get(index) * 2
        inner += put(index) + b"0" + (twice + kind if kind == b"\x86" else b"](" + twice + b"e")
    return inner


def _sparse(rows: int, columns: int) -> bytes:
    parts = {"_shape": (rows, columns), "indptr": np.zeros(2, int), "indices": np.zeros(0, int),
             "data": np.zeros(0)}  # fmt: skip
    state = pickle.dumps(parts, 4)
    return b"cscipy.sparse._csc\ncsc_matrix\n)\x81" + body_of(state) + b"b"


def body_of(pickled: bytes) -> bytes:
    """A pickle without its frames and its end, to be part of another."""
    parts = [
        pickled[start:stop]
        for (opcode, _, start), stop in _opcodes(pickled)
        if opcode.name not in ("PROTO", "FRAME", "STOP")
    ]
    return b"".join(parts)


def _opcodes(pickled: bytes) -> list[tuple[tuple[pickletools.OpcodeInfo, object, int], int]]:
    found = [(code, value, start or 0) for code, value, start in pickletools.genops(pickled)]
    return list(zip(found, [start for _, _, start in found[1:]] + [len(pickled)], strict=True))


def _selection(times: int) -> bytes:
    parts = {"a": np.zeros(1 << 20), "idxs": np.zeros(times, np.uint8)}
    return b"cchumpy.reordering\nSelect\n)\x81" + body_of(pickle.dumps(parts, 4)) + b"b"


PICKLES: dict[str, Callable[[], bytes]] = {
    "calls os.system": lambda: of_x(_call("os", "system", text("echo ran > ran") + b"\x85")),
    "calls eval": lambda: of_x(_call("builtins", "eval", text("open('ran','w')") + b"\x85")),
    "an object with a call": lambda: of_x(b"cos\npopen\n" + text("echo ran > ran") + b"\x85\x81"),
    "an instance by INST": lambda: PROTOCOL + b"(" + text("echo ran > ran") + b"ios\nsystem\n.",
    "an instance by OBJ": lambda: PROTOCOL + b"(cos\nsystem\n" + text("echo ran > ran") + b"o.",
    "an extension code": lambda: PROTOCOL + b"\x82\x01.",
    "NEWOBJ_EX": lambda: of_x(b"cos\nsystem\n" + text("a") + b"\x85}\x92"),
    "objects whose dtype denies them": lambda: of_x(
        array_with(dtype_with("O8", state_of(0)), data=raw(b"\x41" * 32))
    ),
    "a dtype of objects by state": lambda: of_x(array_with(dtype_with("f8", state_of(63)))),
    "a dtype whose fields are a number": lambda: of_x(
        array_with(dtype_with("V8", state_of(0, names=b"K\x07")))
    ),
    "a dtype whose state is a text": lambda: of_x(array_with(dtype_with("f8", text("a")))),
    "a dtype set a thousand times": lambda: of_x(
        array_with(_DTYPE + text("O8") + b"\x89\x88\x87R" + (state_of(0) + b"b") * 1000)
    ),
    "an array of a shape below zero": lambda: of_x(
        array_with(dtype_with("f8", state_of(0, "<")), b"J\xfc\xff\xff\xff\x85")
    ),
    "an array of a shape beyond its bytes": lambda: of_x(
        array_with(dtype_with("f8", state_of(0, "<")), b"J\xff\xff\xff\x7f" * 2 + b"\x86")
    ),
    "an array whose state is itself": lambda: of_x(_ARRAY + b"R" + put(0) + get(0) + b"b"),
    "an array whose data is a list": lambda: of_x(
        array_with(dtype_with("O8", state_of(63)), data=b"](NNNNe")
    ),
    "a scalar of objects": lambda: of_x(
        _call("numpy.core.multiarray", "scalar",
              dtype_with("O8", state_of(0)) + raw(bytes(8)) + b"\x86")
    ),
    "a buffer of objects": lambda: of_x(
        _call("numpy.core.numeric", "_frombuffer",
              b"(" + raw(bytes(32)) + dtype_with("O8", state_of(0)) + b"K\x04\x85" + text("C") + b"t")
    ),
    "an index of the memo of 4 billion": lambda: PROTOCOL + b"}r\xff\xff\xff\xff.",
    "a stored value that is absent": lambda: PROTOCOL + b"h\x07.",
    "lists shared 2⁴⁰ times": lambda: of_x(_doubled(b"e")),
    "tuples shared 2⁴⁰ times": lambda: of_x(_doubled(b"\x86")),
    "a key of shared tuples": lambda: PROTOCOL + b"}" + _doubled(b"\x86") + b"Ns.",
    "tuples nested 100,000 deep": lambda: of_x(b")" + b"\x85" * DEPTH),
    "lists nested 100,000 deep": lambda: of_x(b"]" * DEPTH + b"a" * (DEPTH - 1)),
    "a list in itself": lambda: of_x(b"]" + put(0) + get(0) + b"a"),
    "a text of 8 exabytes": lambda: PROTOCOL + b"\x8d" + b"\xff" * 7 + b"\x7fa.",
    "bytes of 4 gigabytes": lambda: PROTOCOL + b"B\xff\xff\xff\xffa.",
    "an integer of 2 gigabytes": lambda: PROTOCOL + b"\x8b\xff\xff\xff\x7fa.",
    "a frame of 8 exabytes": lambda: PROTOCOL + b"\x95" + b"\xff" * 7 + b"\x7f}.",
    "an integer of 5,000 digits": lambda: PROTOCOL + b"I" + b"9" * 5000 + b"\n.",
    "a persistent id": lambda: of_x(b"Pabc\n"),
    "a persistent id from the stack": lambda: of_x(b"(" + text("a") + b"]" + b"tQ"),
    "a sparse matrix of a quintillion": lambda: of_x(_sparse(1 << 30, 1 << 30)),
    "a sparse matrix that does not fit": lambda: of_x(_sparse(4, 4)),
    "a selection of 16 million": lambda: of_x(_selection(1 << 24)),
    "a mark that is absent": lambda: PROTOCOL + b"t.",
    "more values than were pushed": lambda: PROTOCOL + b"\x87.",
    "no end": lambda: PROTOCOL + b"}",
    "nothing": lambda: b"",
}  # fmt: skip
"""What it does → the pickle, of a dict of the array ``x`` where it has one."""


def write_pickle(folder: Path, name: str) -> Path:
    """Write a pickle."""
    path = folder / "model.pkl"
    path.write_bytes(PICKLES[name]())
    return path


def seed_pickles() -> list[bytes]:
    """Return right pickles of arrays, to be damaged at random."""
    arrays = {"x": np.arange(6.0).reshape(2, 3), "y": np.ones(3, ">i4"), "z": np.float32(2)}
    return [
        pickle.dumps(arrays, 2),
        pickle.dumps(arrays, 4),
        of_x(array_with(dtype_with("O8", state_of(0)))),
        of_x(array_with(dtype_with("f8", state_of(0, "<")))),
    ]
