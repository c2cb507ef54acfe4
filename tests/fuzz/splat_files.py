"""Damaged splat files: mutants of whole ones, inside of their compression too."""

__all__ = ["draw", "mutate"]

import gzip
import json
import random
import struct
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from typing import Any

from support.splat_files import zipped

Mutation = Callable[[bytes, random.Random], bytes]

_SIZES = (0, 1, 2, 255, 256, 0x7FFF, 0xFFFF, 10**6, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)
_VALUES = (
    *(None, True, [], {}, "", "x", -1, 0, 0.5, 1, 7, 255, 65536, 2**31, 2**53, 2**64, 10**400),
    *(1e39, -1e308, float("nan"), float("inf"), [0] * 3, ["x"], {"x": 1}, "../x"),
)


def draw(format: str, seed: int, index: int, samples: Sequence[bytes]) -> bytes:
    """Return the mutant that these numbers decide."""
    rng = random.Random(f"{format} {seed} {index}")
    content = rng.choice(samples)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        content = mutate(content, rng)
    return content


def mutate(content: bytes, rng: random.Random) -> bytes:
    """Change ``content`` at one place, in one of many ways."""
    inner = _CONTAINER_MUTATIONS.get(bytes(content[:4])) or _CONTAINER_MUTATIONS.get(
        bytes(content[:2])
    )
    if inner is not None and rng.random() < 0.5:
        return inner(content, rng)
    return rng.choice(_BYTE_MUTATIONS)(content, rng) if content else b"\0"


def _flip(content: bytes, rng: random.Random) -> bytes:
    result = bytearray(content)
    reach = len(result) if rng.random() < 0.5 else min(len(result), 200)
    for _ in range(rng.choice((1, 1, 2, 8))):
        values = (0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256))
        result[rng.randrange(reach)] = rng.choice(values)
    return bytes(result)


def _resize(content: bytes, rng: random.Random) -> bytes:
    """Put a number where one may be: a count, a length, an offset."""
    result = bytearray(content)
    value = rng.choice((*_SIZES, len(content), len(content) - 1, rng.randrange(2**32)))
    packed = struct.pack("<Q", value)[: rng.choice((2, 4, 4, 8))]
    reach = min(len(result), rng.choice((40, 200, 5200, len(result))))
    offset = rng.randrange(max(1, reach // 4)) * 4
    result[offset : offset + len(packed)] = packed
    return bytes(result)


def _number(content: bytes, rng: random.Random) -> bytes:
    """Replace a number that is written in digits."""
    digits = [offset for offset, byte in enumerate(content[:4000]) if 48 <= byte < 58]
    if not digits:
        return _flip(content, rng)
    index = rng.choice(digits)
    value = rng.choice((*_SIZES, -1, 10**20)) if rng.random() < 0.9 else "nan"
    return content[:index] + str(value).encode() + content[index + rng.choice((0, 1)) :]


def _cut(content: bytes, rng: random.Random) -> bytes:
    offset = rng.randrange(len(content))
    if rng.random() < 0.5:
        return content[:offset]
    return content[:offset] + content[offset + rng.randint(1, 64) :]


def _repeat(content: bytes, rng: random.Random) -> bytes:
    offset, size = rng.randrange(len(content)), rng.randint(1, 300)
    part = content[offset : offset + size]
    to = rng.randrange(len(content))
    return content[:to] + part * rng.choice((1, 1, 20)) + content[to:]


def _lines(content: bytes, rng: random.Random) -> bytes:
    """Drop, double or swap lines, where there are any."""
    head, sign, body = content.partition(b"end_header\n")
    lines = head.split(b"\n")
    if not sign or len(lines) < 4:
        return _repeat(content, rng)
    a, b = rng.randrange(1, len(lines)), rng.randrange(1, len(lines))
    choice = rng.randrange(3)
    if choice == 0:
        del lines[a]
    elif choice == 1:
        lines.insert(a, lines[b])
    else:
        lines[a], lines[b] = lines[b], lines[a]
    return b"\n".join(lines) + sign + body


_BYTE_MUTATIONS: tuple[Mutation, ...] = (
    _flip,
    _flip,
    _resize,
    _resize,
    _number,
    _cut,
    _repeat,
    _lines,
)


def _inside_gzip(content: bytes, rng: random.Random) -> bytes:
    try:
        body = gzip.decompress(content)
    except (OSError, EOFError, zlib.error):
        return _flip(content, rng)
    if rng.random() < 0.05:  # far more than the header says
        return gzip.compress(body + bytes(10**6), 9, mtime=0)
    return gzip.compress(rng.choice(_BYTE_MUTATIONS)(body or b"\0", rng), 1, mtime=0)


def _inside_zip(content: bytes, rng: random.Random) -> bytes:
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            files = {name: archive.read(name) for name in archive.namelist()}
    except Exception:  # it was damaged before
        return _flip(content, rng)
    if not files:
        return _flip(content, rng)
    name = rng.choice([*files, *(["meta.json"] * 8 if "meta.json" in files else [])])
    choice = rng.random()
    if choice < 0.1:
        del files[name]
    elif choice < 0.2:
        files[name] = files[rng.choice([*files])]
    elif choice < 0.25:
        files[name] += bytes(3 * 10**6)
    elif name == "meta.json":
        files[name] = _json(files[name], rng)
    else:
        files[name] = rng.choice(_BYTE_MUTATIONS)(files[name] or b"\0", rng)
    methods = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
    return zipped(files, rng.choice(methods))


def _inside_glb(content: bytes, rng: random.Random) -> bytes:
    if len(content) < 28:
        return _flip(content, rng)
    size = min(struct.unpack_from("<I", content, 12)[0], len(content) - 20)
    text = _json(content[20 : 20 + size], rng)
    text += b" " * (-len(text) % 4)
    total = len(content) - size + len(text)
    head = struct.pack("<4sIII4s", b"glTF", 2, total, len(text), b"JSON")
    return head + text + content[20 + size :]


def _json(text: bytes, rng: random.Random) -> bytes:
    """Replace, drop or double a value somewhere in JSON."""
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        return _flip(text or b"\0", rng)
    container: Any = data
    while True:
        keys = [*container] if isinstance(container, Mapping) else [*range(len(container))]
        if not keys:
            break
        key = rng.choice(keys)
        inner = container[key]
        if isinstance(inner, dict | list) and inner and rng.random() < 0.85:
            container = inner
            continue
        choice = rng.random()
        if choice < 0.15:
            del container[key]
        elif choice < 0.3:
            container[key] = container[rng.choice(keys)]
        else:
            container[key] = rng.choice(_VALUES)
        break
    try:
        return json.dumps(data).encode()
    except ValueError:  # 10**400 has more digits than Python prints
        return text


_CONTAINER_MUTATIONS: Mapping[bytes, Mutation] = {
    b"\x1f\x8b": _inside_gzip,
    b"PK\x03\x04": _inside_zip,
    b"glTF": _inside_glb,
}
