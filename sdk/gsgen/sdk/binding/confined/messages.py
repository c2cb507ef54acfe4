"""Messages between a program and the confined child process that runs its models: JSON, framed."""

__all__ = ["Message", "error_of", "message_of", "receive", "send"]

import json
import socket
import struct
from collections.abc import Sequence
from typing import Any, Final

from gsgen.contract import errors as contract_errors
from gsgen.contract.errors import GsgenError
from gsgen.sdk.binding.providers import errors as binding_errors
from gsgen.sdk.binding.providers.errors import RunFailed

Message = dict[str, Any]

_LENGTH_STRUCT: Final = struct.Struct("<I")
_MAX_BYTES: Final = 64 << 20  # of a message; the names of a million nodes take less


def send(channel: socket.socket, message: Message, descriptors: Sequence[int] = ()) -> None:
    """Send a message, and descriptors of files that the receiver gets copies of."""
    data = json.dumps(message, separators=(",", ":")).encode()
    data = _LENGTH_STRUCT.pack(len(data)) + data
    sent_byte_count = socket.send_fds(channel, [data], descriptors) if descriptors else 0
    channel.sendall(data[sent_byte_count:])


def receive(channel: socket.socket, descriptors: int = 0) -> tuple[Message | None, list[int]]:
    """Return the next message and the descriptors that came with it; None at the channel's end.

    Args:
        channel: A stream, whose timeout limits the wait.
        descriptors: The most descriptors to take.

    Raises:
        TimeoutError: The time is over.
        RunFailed: The message is not one of ours.
    """
    head, files, *_ = socket.recv_fds(channel, _LENGTH_STRUCT.size, descriptors)
    head += _read(channel, _LENGTH_STRUCT.size - len(head)) if head else b""
    if len(head) < _LENGTH_STRUCT.size:
        return None, files
    (size,) = _LENGTH_STRUCT.unpack(head)
    data = _read(channel, size) if size <= _MAX_BYTES else b""
    if len(data) < size <= _MAX_BYTES:
        return None, files
    try:
        message = json.loads(data)
    except ValueError as error:
        raise RunFailed("the process that runs the model sent no message") from error
    return message if isinstance(message, dict) else {}, files


def _read(channel: socket.socket, size: int) -> bytes:
    """Return ``size`` bytes, or fewer at the channel's end."""
    data = bytearray()
    while len(data) < size and (part := channel.recv(min(size - len(data), 1 << 20))):
        data += part
    return bytes(data)


def message_of(error: GsgenError) -> Message:
    """Return an error as a message."""
    texts = {"message": error.message, "where": error.where, "hint": error.hint}
    return {"error": type(error).__name__} | texts


def error_of(message: Message) -> GsgenError:
    """Return the error that a message holds, of its type if that is one of gsgen's."""
    name = str(message.get("error"))
    kind = getattr(binding_errors, name, None) or getattr(contract_errors, name, None)
    if not (isinstance(kind, type) and issubclass(kind, GsgenError)):
        kind = RunFailed
    texts = {key: str(message.get(key, "")) for key in ("where", "hint")}
    return kind(str(message.get("message")), **texts)
