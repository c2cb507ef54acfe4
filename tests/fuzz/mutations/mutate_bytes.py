"""Mutations of a file: bytes that no protobuf library would write."""

__all__ = ["MUTATIONS", "Mutation"]

import random
from collections.abc import Callable

from gsgen.contract.model.protobuf_scan import BYTES, Field, WireFault, scan

Mutation = Callable[[bytes, random.Random], bytes]

# Numbers of ten bytes and more, groups, a field number of zero, a length beyond any file.
_HOSTILE_BYTES = (
    *(b"\xff" * 10, b"\xff" * 9 + b"\x01", b"\x0b\x0c", b"\x00\x00", b"\x3a\xff\xff\xff\xff\x0f"),
    *(b"\x3a\x00", b"\x80\x80\x80\x00", b"\xf8\xff\xff\xff\x0f\x01", b"\x72\x02\x0a\x00"),
)
_DEPTH = 6


def _fields(data: bytes, rng: random.Random) -> list[Field]:
    """Return the fields of a message somewhere in the file: of the model, or deeper."""
    start, end = 0, len(data)
    results: list[Field] = []
    for _ in range(rng.randint(1, _DEPTH)):
        try:
            inside = list(scan(data, start, end))
        except WireFault:
            break
        if not inside:
            break
        results = inside
        nested_fields = [
            entry for entry in inside if entry.wire_type == BYTES and entry.end > entry.value
        ]
        if not nested_fields:
            break
        field = rng.choice(nested_fields)
        start, end = field.value, field.end
    return results


def flip(data: bytes, rng: random.Random) -> bytes:
    """Change single bytes, near the start of the file more often than not."""
    result = bytearray(data)
    reach = len(result) if rng.random() < 0.4 else min(len(result), 400)
    for _ in range(rng.choice((1, 1, 2, 8))):
        result[rng.randrange(reach)] = rng.choice((0, 1, 0x7F, 0x80, 0xFF, rng.randrange(256)))
    return bytes(result)


def cut(data: bytes, rng: random.Random) -> bytes:
    """End the file early, or let its middle be missing."""
    offset = rng.randrange(len(data))
    return (
        data[:offset] if rng.random() < 0.5 else data[:offset] + data[offset + rng.randint(1, 64) :]
    )


def drop_a_field(data: bytes, rng: random.Random) -> bytes:
    """Take a field out; lengths around it are left as they were."""
    fields = _fields(data, rng)
    if not fields:
        return data
    field = rng.choice(fields)
    return data[: field.start] + data[field.end :]


def repeat_a_field(data: bytes, rng: random.Random) -> bytes:
    """Write a field of the model twice, or two fields in the other order."""
    try:
        fields = list(scan(data, 0, len(data)))
    except WireFault:
        return data
    if not fields:
        return data
    field = rng.choice(fields)
    part = data[field.start : field.end]
    if rng.random() < 0.5:
        return data + part * rng.choice((1, 1, 30))
    return part + data[: field.start] + data[field.end :]


def insert(data: bytes, rng: random.Random) -> bytes:
    """Put odd bytes before a field."""
    fields = _fields(data, rng)
    offset = rng.choice(fields).start if fields else rng.randrange(len(data))
    return data[:offset] + rng.choice(_HOSTILE_BYTES) + data[offset:]


def retag(data: bytes, rng: random.Random) -> bytes:
    """Let a field have another number or another wire type."""
    fields = _fields(data, rng)
    if not fields:
        return data
    offset = rng.choice(fields).start
    return data[:offset] + bytes([rng.randrange(256)]) + data[offset + 1 :]


def nest_graph(data: bytes, rng: random.Random) -> bytes:
    """Wrap a graph that is nested deeper than anybody nests graphs."""
    body = b""
    for _ in range(rng.choice((20, 90, 110, 400))):
        attribute = b"\x0a\x01b" + _sized(0x32, body) + b"\xa0\x01\x05"
        body = _sized(0x0A, b"\x22\x02If" + _sized(0x2A, attribute))
    return data + _sized(0x3A, body)


def _sized(tag: int, body: bytes) -> bytes:
    size, out = len(body), bytearray([tag])
    while size > 0x7F:
        out.append(size & 0x7F | 0x80)
        size >>= 7
    return bytes(out) + bytes([size]) + body


MUTATIONS: tuple[Mutation, ...] = (
    flip,
    flip,
    cut,
    drop_a_field,
    repeat_a_field,
    insert,
    retag,
    nest_graph,
)
