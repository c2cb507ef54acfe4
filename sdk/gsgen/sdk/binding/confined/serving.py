"""Sessions of models in the confined child process: each opens one and computes its frames."""

__all__ = ["serve_sessions"]

import socket
import threading
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any, final

from gsgen.contract.errors import GsgenError
from gsgen.contract.probing.sandbox_worker import error_line
from gsgen.contract.process.child_status import memory_refused
from gsgen.contract.process.limits import (
    DRIVER_BYTES,
    is_out_of_memory,
    limit_memory,
    limit_processor_time,
)
from gsgen.contract.spec.manifest_io import loads
from gsgen.sdk.binding.bound.bound_session import translate_error
from gsgen.sdk.binding.bound.model_facts import read_model_facts
from gsgen.sdk.binding.bound.warm_up import WarmSession, lock_of, open_warm
from gsgen.sdk.binding.confined.messages import Message, message_of, receive, send
from gsgen.sdk.binding.confined.shared_arrays import SharedArraySlot, SharedMemory
from gsgen.sdk.binding.providers.cancellation import Stop
from gsgen.sdk.binding.providers.errors import RunFailed


def serve_sessions(control: socket.socket, job: Message) -> None:
    """Open and run models as messages of the control channel ask, until it is closed.

    A message that asks for a session comes with two descriptors: the session's own channel, and the
    memory that its tensors share with the parent. Each session has a thread.
    """
    import onnxruntime

    warnings.simplefilter("ignore")  # the parent gives those of a session
    onnxruntime.set_default_logger_severity(4)
    send(control, {"ready": onnxruntime.__version__})
    sessions: dict[int, _Session] = {}
    while True:
        message, files = receive(control, descriptors=2)
        if message is None:  # the parent has ended
            return
        if "stop" in message:
            sessions[message["stop"]].stop_frame(message["frame"])
            continue
        session = sessions[message["session"]] = _Session(files, message, job)
        threading.Thread(target=session.serve, daemon=True).start()


@final
class _Session:
    """One model, which a thread of its own opens and runs."""

    def __init__(self, files: list[int], request: Message, job: Message) -> None:
        self._channel = socket.socket(fileno=files[0])
        self._memory_file = files[1]
        self._request, self._job_settings = request, job
        self._host_limit = job["host_limit"]
        self._stop, self._frame, self._lock = Stop(), 0, threading.Lock()
        self._stopped_frame: int | None = None

    def serve(self) -> None:
        """Open the model, then run it for each message, until the channel is closed."""
        session: WarmSession | None = None
        with self._channel, suppress(BrokenPipeError, ConnectionResetError):
            message: Message | None = self._request
            while message is not None:
                try:
                    if session is None:
                        session = self._open_session()
                        self._device_lock = lock_of(session.choice)
                        reply = self._describe_session(session)
                    else:
                        reply = self._reply_to_message(session, message)
                except Exception as error:
                    reply = message_of(self._error(error))
                send(self._channel, reply)
                message = receive(self._channel)[0] if session is not None else None
        if session is not None:
            session.bound.close()

    def stop_frame(self, number: int) -> None:
        """Cancel the run of a frame, if that is the one that runs, or when it begins."""
        with self._lock:
            self._stopped_frame = number  # its own message may come later, by another channel
            if number == self._frame:
                self._stop.now()

    def _open_session(self) -> WarmSession:
        request = self._request
        self._shared_memory = SharedMemory(self._memory_file)
        manifest = None if request["manifest"] is None else loads(request["manifest"])
        limit_processor_time(self._job_settings["seconds"])
        return open_warm(
            read_model_facts(Path(request["path"]), manifest),
            provider=request["provider"],
            capture=request["capture"],
            sizes=request["sizes"],
            threads=request["threads"],
            stop=self._stop,
            host_memory=self._shared_memory,
            before=self._limit_memory,
        )

    def _limit_memory(self, provider: str) -> None:
        """Limit the memory of this process, unless CUDA reserves addresses for all of a GPU's."""
        if provider != "cuda":
            limit_memory(self._job_settings["memory"] + DRIVER_BYTES * (provider == "webgpu"))

    def _describe_session(self, session: WarmSession) -> Message:
        places = {
            kind: {name: self._place_output_array(buffer) for name, buffer in buffers.items()}
            for kind, buffers in (
                ("inputs", session.bound.inputs),
                ("outputs", session.bound.outputs),
            )
        }
        return places | {
            "provider": session.provider,
            "reason": session.reason,
            "device": session.device,
            "captured": session.captured,
            "cause": session.cause,
            "nodes": [[node.provider, node.operator, node.name] for node in session.nodes],
        }

    def _place_output_array(self, buffer: Any) -> list[Any]:
        array_slot: SharedArraySlot = self._shared_memory.place_of(buffer.host)
        return [array_slot.offset, list(array_slot.shape), array_slot.dtype.name]

    def _reply_to_message(self, session: WarmSession, message: Message) -> Message:
        if "read" in message:
            with self._device_lock:
                session.bound.read(message["read"])
            return {}
        with self._lock:
            self._frame = message["frame"]
            if self._frame == self._stopped_frame:
                self._stop.now()
            else:
                self._stop.reset()
        limit_processor_time(self._job_settings["seconds"])
        with self._device_lock:
            for name in message["changed"]:
                session.bound.inputs[name].upload()
            session.bound.run()
        return {}

    def _error(self, error: Exception) -> GsgenError:
        if is_out_of_memory(error):
            memory, host_limit = self._job_settings["memory"], self._host_limit
            if host_limit < memory:
                return memory_refused(memory, host_limit, error_line(error))
            limit = f"{memory >> 20:,} MiB, the memory limit (--memory)"
            return RunFailed(f"needs more than {limit}", where=self._request["path"])
        translated_error = translate_error(error)
        translated_error.where = translated_error.where or self._request["path"]
        return translated_error
