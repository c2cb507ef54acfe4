"""Reads the structure of an ONNX file without its weights, from the protobuf wire format.

A model is mostly tensor payload. This scanner walks the fields of the file, copies all but
the payload of large tensors, and leaves a model that protobuf parses in milliseconds.
Source: "Encoding", protobuf.dev, and ``onnx.proto`` of ONNX 1.18 for the field numbers.
"""

__all__ = ["STUB_BYTES", "Field", "StrippedModel", "WireFault", "scan", "strip_payloads", "varint"]

from collections.abc import Iterator
from dataclasses import dataclass

Buffer = bytes | memoryview

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5

# Messages that may hold tensors: message → field number → message inside.
_NESTED_MESSAGES: dict[str, dict[int, str]] = {
    "Model": {7: "Graph", 20: "Training", 25: "Function"},
    "Training": {1: "Graph", 2: "Graph"},
    "Graph": {1: "Node", 5: "Tensor", 15: "Sparse"},
    "Function": {7: "Node", 11: "Attribute"},
    "Node": {5: "Attribute"},
    "Attribute": {5: "Tensor", 6: "Graph", 10: "Tensor", 11: "Graph", 22: "Sparse", 23: "Sparse"},
    "Sparse": {1: "Tensor", 2: "Tensor"},
}
# TensorProto: float_data int32_data string_data int64_data raw_data double_data uint64_data.
_PAYLOAD_FIELDS = frozenset({4, 5, 6, 7, 9, 10, 11})
_TENSOR_TYPE, _TENSOR_RAW = 2, 9
_INTEGER_TYPES = frozenset({6, 7})  # int32, int64: shape inference may want their values

# The stub that replaces a payload.
STUB_BYTES = b"\0"

# A message up to this size is copied whole: scanning it would cost more than it saves.
_MAX_SMALL_MESSAGE = 2048
_MAX_INTEGER_PAYLOAD = 1 << 20
_MAX_FIELDS = 1_000_000
_MAX_DEPTH = 100
_MAX_RETAINED_BYTES = 256 << 20


class WireFault(ValueError):
    """Raised if the bytes are not a well-formed protobuf message."""

    def __init__(self, offset: int, message: str) -> None:
        self.offset = offset
        super().__init__(f"byte {offset}: {message}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One field of a protobuf message: its tag's offset and its value's byte range."""

    number: int
    wire_type: int
    start: int
    value: int
    end: int


@dataclass(slots=True)
class StrippedModel:
    """A serialised ONNX model without the payload of its large tensors."""

    data: bytes = b""
    stripped_bytes: int = 0


def varint(data: Buffer, offset: int, end: int) -> tuple[int, int]:
    """Decode a protobuf varint at ``offset``; return the number and the offset after it."""
    value = shift = 0
    while offset < end:
        byte = data[offset]
        offset += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, offset
        shift += 7
        if shift > 63:
            raise WireFault(offset, "a protobuf number of more than ten bytes")
    raise WireFault(offset, "the file ends inside a protobuf number")


def scan(data: Buffer, start: int, end: int) -> Iterator[Field]:
    """Yield the fields of the protobuf message in ``data[start:end]``, without copying.

    Raises:
        WireFault: A field is malformed or reaches beyond ``end``.
    """
    offset = start
    while offset < end:
        tag_offset = offset
        tag, offset = varint(data, offset, end)
        number, wire_type = tag >> 3, tag & 7
        if wire_type == BYTES:
            size, offset = varint(data, offset, end)
            end_offset = offset + size
        elif wire_type == VARINT:
            _, end_offset = varint(data, offset, end)
        elif wire_type in (FIXED32, FIXED64):
            end_offset = offset + (4 if wire_type == FIXED32 else 8)
        else:
            raise WireFault(tag_offset, f"protobuf wire type {wire_type}, which ONNX does not use")
        if number == 0:
            raise WireFault(tag_offset, "protobuf field number 0, expected 1 or more")
        if end_offset > end:
            raise WireFault(
                tag_offset,
                f"field {number} needs {end_offset - end} more bytes than the message has",
            )
        yield Field(
            number=number, wire_type=wire_type, start=tag_offset, value=offset, end=end_offset
        )
        offset = end_offset


def strip_payloads(data: Buffer) -> StrippedModel:
    """Return the serialised ONNX model in ``data`` without the payload of its large tensors."""
    builder = _Builder(data)
    stripped_model = builder.result
    stripped_model.data = b"".join(builder.message("Model", 0, len(data), 0))
    return stripped_model


class _Builder:
    """Copies a protobuf message field by field, within bounds on work and memory."""

    def __init__(self, data: Buffer) -> None:
        self.data = data
        self.result = StrippedModel()
        self.fields = 0
        self.kept_bytes = 0

    def message(self, kind: str, start: int, end: int, depth: int) -> list[bytes]:
        if depth > _MAX_DEPTH:
            raise WireFault(start, f"graphs are nested more than {_MAX_DEPTH} deep")
        if kind == "Tensor":
            return self._tensor(start, end)
        nested_kind = _NESTED_MESSAGES[kind]
        parts: list[bytes] = []
        for field in scan(self.data, start, end):
            self._count(field.start)
            inner_message = nested_kind.get(field.number)
            if (
                inner_message is None
                or field.wire_type != BYTES
                or field.end - field.value <= _MAX_SMALL_MESSAGE
            ):
                parts.append(self._copy_range(field.start, field.end))
                continue
            body = self.message(inner_message, field.value, field.end, depth + 1)
            parts.append(_header(field.number, sum(map(len, body))))
            parts.extend(body)
        return parts

    def _tensor(self, start: int, end: int) -> list[bytes]:
        fields: list[Field] = []
        for field in scan(self.data, start, end):
            self._count(field.start)
            fields.append(field)
        dtype = next(
            (f for f in fields if f.number == _TENSOR_TYPE and f.wire_type == VARINT), None
        )
        code = varint(self.data, dtype.value, dtype.end)[0] if dtype else 0
        if code in _INTEGER_TYPES and end - start <= _MAX_INTEGER_PAYLOAD:
            return [self._copy_range(start, end)]
        retained_parts: list[bytes] = []
        payload = 0
        for field in fields:
            if field.number in _PAYLOAD_FIELDS:
                payload += field.end - field.value
            else:
                retained_parts.append(self._copy_range(field.start, field.end))
        self.result.stripped_bytes += payload
        if payload:  # a stub, so that the tensor still has a data field
            retained_parts.append(_header(_TENSOR_RAW, len(STUB_BYTES)) + STUB_BYTES)
        return retained_parts

    def _copy_range(self, start: int, end: int) -> bytes:
        self.kept_bytes += end - start
        if self.kept_bytes > _MAX_RETAINED_BYTES:
            raise WireFault(
                start,
                f"the model holds more than {_MAX_RETAINED_BYTES >> 20} MiB besides tensor payload",
            )
        return bytes(self.data[start:end])

    def _count(self, offset: int) -> None:
        self.fields += 1
        if self.fields > _MAX_FIELDS:
            raise WireFault(offset, f"the model holds more than {_MAX_FIELDS} protobuf fields")


def _header(number: int, size: int) -> bytes:
    out = bytearray()
    for value in (number << 3 | BYTES, size):
        while value > 0x7F:
            out.append(value & 0x7F | 0x80)
            value >>= 7
        out.append(value)
    return bytes(out)
