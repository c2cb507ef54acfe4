"""The fields of ONNX's protobuf messages, as a table that the browser client decodes files by."""

__all__ = ["message_fields"]

from google.protobuf.descriptor import FieldDescriptor
from onnx import ModelProto

_WORDS = {
    FieldDescriptor.TYPE_STRING: "text",
    FieldDescriptor.TYPE_BYTES: "bytes",
    FieldDescriptor.TYPE_FLOAT: "float",
    FieldDescriptor.TYPE_DOUBLE: "double",
}


def message_fields() -> dict[str, list[list[object]]]:
    """Return number, name, kind and repetition of the fields of all protobuf messages of ONNX.

    A kind is ``text``, ``bytes``, ``float``, ``double``, ``int`` or the name of a message.
    """
    messages: dict[str, list[list[object]]] = {}
    queue = [ModelProto.DESCRIPTOR]
    while queue:
        message = queue.pop()
        if message.full_name in messages:
            continue
        rows: list[list[object]] = []
        for field in message.fields:
            kind = _WORDS.get(field.type, "int")
            if field.message_type is not None:
                kind = field.message_type.full_name
                queue.append(field.message_type)
            rows.append([field.number, field.name, kind, int(field.is_repeated)])
        messages[message.full_name] = rows
    return messages
