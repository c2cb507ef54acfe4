"""Reads random pickles and .npy files; any crash or unknown exception ends the process.

python -m support.hostile.random_bytes pickles 20000 [SEED]
python -m support.hostile.random_bytes headers 20000 [SEED]
"""

__all__ = ["CHECKED_MEMORY", "run_checked"]

import os
import pickle
import random
import struct
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

from gsgen.contract.process.array_files import ArraysUnreadable, read_array_file
from gsgen.reference_plugins.loading.array_pickles import read_array_pickle
from gsgen.reference_plugins.loading.errors import CheckpointInvalid
from support.hostile import pickles
from support.hostile.motions import array_bytes, npy_of

_FLAGS = (0, 1, 2, 8, 16, 27, 63, 255)
_CODES = ("f8", "f4", "f2", "i4", "u1", "b1", "O8", "O", "V8", "S4", "U2", "M8", "c16", "f8,i4", "")
_SIZES = (0, 1, 2, 3, 4, 8, -1, -4, 255, 1 << 31, (1 << 63) - 1, 1 << 70)

# What makes the C library check every block of memory, and fill freed ones.
CHECKED_MEMORY = {
    "PYTHONFAULTHANDLER": "1",
    "PYTHONMALLOC": "malloc",
    "MALLOC_CHECK_": "3",
    "MALLOC_PERTURB_": "165",
    "GLIBC_TUNABLES": "glibc.malloc.check=3:glibc.malloc.perturb=165",
}


def run_checked(kind: str, count: int, seed: int = 0) -> subprocess.CompletedProcess[str]:
    """Read ``count`` random files in a process whose memory is checked."""
    environment = os.environ | CHECKED_MEMORY
    environment["PYTHONPATH"] = str(Path(__file__).parents[2])
    if sys.platform == "linux":  # since glibc 2.34, the checks are in a library of their own
        environment["LD_PRELOAD"] = "libc_malloc_debug.so.0"
    command = [sys.executable, "-m", "support.hostile.random_bytes", kind, str(count), str(seed)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def random_value(choice: random.Random, depth: int = 0) -> object:
    """Return what a state of a dtype or an array may hold, or may not."""
    kind = choice.randrange(9 if depth < 3 else 5)
    if kind == 0:
        return choice.choice(_SIZES)
    if kind == 1:
        return choice.choice((*_CODES, "<", ">", "|", "=", "a"))
    if kind == 2:
        return choice.choice((None, True, False, 0.5))
    if kind == 3:
        return choice.randbytes(choice.choice((0, 1, 8, 32, 33)))
    if kind == 4:
        return choice.choice(_FLAGS)
    items = [random_value(choice, depth + 1) for _ in range(choice.randrange(4))]
    if kind == 5:
        return {str(number): item for number, item in enumerate(items)}
    return tuple(items) if kind < 8 else items


def _opcodes_of(value: object) -> bytes:
    return pickles.body_of(pickle.dumps(value, 4))


def random_pickle(choice: random.Random) -> bytes:
    """Return a pickle with a random state of a dtype or an array, or a damaged right pickle."""
    if choice.random() < 0.3:
        content = bytearray(choice.choice(pickles.seed_pickles()))
        for _ in range(choice.randrange(1, 6)):
            content[choice.randrange(len(content))] = choice.randrange(256)
        return bytes(content)
    code = choice.choice(_CODES)
    if choice.random() < 0.5:
        dtype_state = pickles.state_of(choice.choice(_FLAGS), choice.choice("<>|="))
    else:
        dtype_state = _opcodes_of(random_value(choice))
    dtype = pickles.dtype_with(code, dtype_state)
    if choice.random() < 0.5:
        shape = _opcodes_of(tuple(choice.choice(_SIZES) for _ in range(choice.randrange(4))))
        data = _opcodes_of(random_value(choice))
        return pickles.of_x(pickles.array_with(dtype, shape, data))
    if choice.random() < 0.5:
        return pickles.of_x(pickles.array_with(dtype))
    return pickles.of_x(pickles.array_set_to(_opcodes_of(random_value(choice))))


def random_array_file(choice: random.Random) -> bytes:
    """Return an .npy file with a random header, or a damaged right one."""
    if choice.random() < 0.3:
        content = bytearray(array_bytes())
        for _ in range(choice.randrange(1, 6)):
            content[choice.randrange(128)] = choice.randrange(256)
        return bytes(content)
    shape = tuple(choice.choice(_SIZES[:8]) for _ in range(choice.randrange(4)))
    code = choice.choice(_CODES)
    descr: object = choice.choice((f"<{code}", f">{code}", f"|{code}", code, random_value(choice)))
    header = {"descr": descr, "fortran_order": choice.choice((True, False, 0, None)),
              "shape": choice.choice((shape, random_value(choice)))}  # fmt: skip
    if choice.random() < 0.1:
        header[choice.choice("abc")] = random_value(choice)
    content = npy_of(repr(header), choice.randbytes(choice.choice((0, 8, 16, 64, 96))))
    if choice.random() < 0.2:  # another length of the header
        content = content[:8] + struct.pack("<H", choice.randrange(1 << 16)) + content[10:]
    return content


def _read_pickle(path: Path) -> None:
    for array in read_array_pickle(path, ["x", "y", "z"]).values():
        array.tobytes()


def _read_arrays(path: Path) -> None:
    for array in read_array_file(path).values():
        array.tobytes()


def main() -> None:
    """Read random files of one kind, and print how many of them were refused."""
    kind, count, seed = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    makers: dict[str, tuple[Callable[[random.Random], bytes], Callable[[Path], None]]] = {
        "pickles": (random_pickle, _read_pickle),
        "headers": (random_array_file, _read_arrays),
    }
    make, read = makers[kind]
    choice, refused = random.Random(seed), 0
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory(prefix="gsgen-") as folder:
        path = Path(folder) / "a"
        for number in range(count):
            path.write_bytes(make(choice))
            try:
                read(path)
            except (CheckpointInvalid, ArraysUnreadable):
                refused += 1
            except Exception as error:
                sys.exit(f"{kind}, seed {seed}, number {number}: {error!r}: {path.read_bytes()!r}")
    sys.stdout.write(f"{count} {kind}, {refused} refused, {count - refused} read\n")


if __name__ == "__main__":
    main()
