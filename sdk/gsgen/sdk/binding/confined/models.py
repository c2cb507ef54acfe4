"""Child processes that run models of strangers, with limits on what they can do and take."""

__all__ = ["CAN_CONFINE", "Channel", "ConfinedModels"]

import os
import socket
import subprocess
import tempfile
import threading
import weakref
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, Self, final

from gsgen.contract.errors import GsgenError, HostProcessFailed, ModelUnreadable
from gsgen.contract.model.files_beside import loaded_files
from gsgen.contract.model.model_file import ModelFile, open_model
from gsgen.contract.process.child_status import classify_child_end
from gsgen.contract.process.limits import FRAME_SECONDS, Limits, inherited_memory_limit
from gsgen.contract.process.parent_watchdog import child_environment, python_command
from gsgen.sdk.binding.bound.bound_session import host_bytes
from gsgen.sdk.binding.confined.messages import Message, error_of, receive, send
from gsgen.sdk.binding.confined.shared_arrays import SharedMemory, create_memory_file
from gsgen.sdk.binding.providers.cancellation import Stop
from gsgen.sdk.binding.providers.errors import RunFailed, SessionClosed

CAN_CONFINE: Final = hasattr(socket, "send_fds")
"""Whether this system can run models in a confined child process; Windows cannot."""

_WORKER: Final = "gsgen.sdk.binding.confined.worker"
_START_SECONDS: Final = 60.0
_STOP_SECONDS: Final = 2.0  # for a cancelled run to end, before its process is killed
_LOG_BYTES: Final = 1 << 16


@final
class ConfinedModels:
    """Runs models in child processes that are limited in time, memory, files and network.

    ::

        with ConfinedModels(["avatar.onnx", "denoiser.onnx"]) as confined:
            avatar = FrameSession("avatar.onnx", confined=confined)

    The models that are named share one process, which starts at once. Another model gets a
    process of its own when it is opened, because a process cannot be allowed further files.

    Args:
        models: Model files that will be opened; files that are not models are ignored.
        limits: Seconds for loading a model and for each frame, and bytes of memory; memory for
            the weights is added.
        has_gpu: Allow the named models the devices of GPUs, which all providers but cpu need.
    """

    def __init__(
        self,
        models: Iterable[str | Path] = (),
        limits: Limits | None = None,
        *,
        has_gpu: bool = False,
    ) -> None:
        if not CAN_CONFINE:
            raise HostProcessFailed("this system cannot run models in a confined process")
        self.limits = limits = limits or Limits(seconds=FRAME_SECONDS)
        self._lock = threading.Lock()
        self._children: list[_ChildProcess] = []
        files: list[ModelFile] = []
        for path in map(Path, models):
            with suppress(ModelUnreadable):  # reported where the model is opened
                files.append(open_model(path))
        self._shared_child = _ChildProcess(files, limits, has_gpu=has_gpu) if files else None
        if self._shared_child is not None:
            self._children.append(self._shared_child)
        # Sessions refer to this object: without it and without sessions, the processes end.
        weakref.finalize(self, _end_all_children, self._children)

    def open(self, file: ModelFile, request: Message) -> "Channel":
        """Return a channel to a session that opens a model; :meth:`Channel.ask` for its facts."""
        needs_gpu = request["provider"] != "cpu"
        with self._lock:
            if self._shared_child is not None and self._shared_child.may_open(
                file, needs_gpu=needs_gpu
            ):
                return self._shared_child.channel(file, request)
            child = _ChildProcess([file], self.limits, has_gpu=needs_gpu)
            self._children[:] = [*(other for other in self._children if other.is_running), child]
        return child.channel(file, request, is_last=True)

    def close(self) -> None:
        """End all processes; a second call has no effect."""
        with self._lock:
            _end_all_children(self._children)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def _end_all_children(children: "list[_ChildProcess]") -> None:
    while children:
        hint = "Close ConfinedModels after its sessions."
        children.pop().end(SessionClosed("the process that runs the model was closed", hint=hint))


@final
class _ChildProcess:
    """A confined process, started when it is created."""

    def __init__(self, files: Iterable[ModelFile], limits: Limits, *, has_gpu: bool) -> None:
        self._files = list(files)
        self._readable_files = {path for file in self._files for path in loaded_files(file)}
        self.limits = limits.for_model(sum(file.weight_bytes for file in self._files))
        self._has_gpu = has_gpu
        self._end_cause: GsgenError | None = None  # why this process ended it
        self._is_ready, self._session_count = False, 0
        self._channels: list[socket.socket] = []
        self._lock, self._process_end_lock = threading.Lock(), threading.Lock()
        self._log, self._log_text = _log_file(), ""
        self._control_socket, child_socket = socket.socketpair()
        with child_socket:
            try:
                self._process = subprocess.Popen(
                    [*python_command(), "-m", _WORKER, str(child_socket.fileno())],
                    stdin=subprocess.DEVNULL,
                    stdout=self._log,
                    stderr=self._log,
                    pass_fds=[child_socket.fileno()],
                    env=child_environment(),
                    start_new_session=True,
                )
            except OSError as error:
                message = f"no process can be started for the model: {error.strerror}"
                raise HostProcessFailed(message) from error
        job = {
            "readable": [str(path) for path in self._readable_files],
            "memory": self.limits.memory,
            "seconds": self.limits.seconds,
            "has_gpu": has_gpu,
            "host_limit": inherited_memory_limit(),
        }
        with suppress(OSError):  # it has ended, which the first session reports
            send(self._control_socket, job)

    @property
    def is_running(self) -> bool:
        """Whether the process has not ended."""
        return self._process.poll() is None

    def may_open(self, file: ModelFile, *, needs_gpu: bool) -> bool:
        """Return whether the process may read a model's files, and still runs."""
        is_gpu_use_allowed = self._has_gpu or not needs_gpu
        return (
            self.is_running
            and is_gpu_use_allowed
            and self._readable_files.issuperset(loaded_files(file))
        )

    def channel(self, file: ModelFile, request: Message, *, is_last: bool = False) -> "Channel":
        """Begin to open a model; ``is_last`` ends the process with this session."""
        memory_file = create_memory_file(min(self.limits.memory, host_bytes()))
        parent_socket, child_socket = socket.socketpair()
        with child_socket:
            with self._lock:
                self._await_process_start()
                self._session_count += 1
                self._channels.append(parent_socket)
                message = request | {"session": self._session_count, "path": str(file.path)}
                try:
                    send(self._control_socket, message, [child_socket.fileno(), memory_file])
                except OSError as error:
                    raise self.death(str(file.path)) from error
            shared = SharedMemory(memory_file)
        return Channel(
            child=self,
            socket=parent_socket,
            shared=shared,
            number=self._session_count,
            where=str(file.path),
            is_last=is_last,
        )

    def _await_process_start(self) -> None:
        """Wait until the process has imported what it needs."""
        if self._is_ready:
            return
        self._control_socket.settimeout(_START_SECONDS)
        try:
            message, _ = receive(self._control_socket)
        except TimeoutError:
            self.end(HostProcessFailed(f"no process for models starts within {_START_SECONDS:g} s"))
            message = None
        except OSError:
            message = None
        if message is None or "ready" not in message:
            raise self.death("")
        self._control_socket.settimeout(_STOP_SECONDS)
        self._is_ready = True

    def stop_frame(self, session: int, frame: int) -> None:
        """Cancel the run of a frame of a session."""
        with self._lock, suppress(OSError):
            send(self._control_socket, {"stop": session, "frame": frame})

    def end(self, cause: GsgenError | None = None) -> None:
        """Kill the process, and record why; nothing happens if it has ended."""
        with self._process_end_lock:
            if self._process.poll() is None:
                self._end_cause = self._end_cause or cause
                self._process.kill()
            self._process.wait()
            if not self._log.closed:
                self._log.seek(0)
                self._log_text = self._log.read(_LOG_BYTES).decode(errors="replace")
                for file in (self._log, self._control_socket, *self._channels):
                    file.close()

    def death(self, where: str) -> GsgenError:
        """Return why the process ended, which it has or is about to."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_STOP_SECONDS)
        self.end(RunFailed("the process that runs the model closed its channel", where=where))
        if self._end_cause is not None:
            return self._end_cause
        status, log = self._process.returncode, self._log_text
        if not self._is_ready:
            lines = log.strip().splitlines()[-1:] or [f"exit status {status}"]
            return HostProcessFailed(f"the process for models does not start: {lines[0][:300]}")
        death = classify_child_end(status, log, self.limits)
        is_host_fault = death.stage == "host"
        if death.stage in ("memory", "crash"):
            is_host_fault = inherited_memory_limit() < self.limits.memory
        kind = HostProcessFailed if is_host_fault else RunFailed
        return kind(f"the process that runs the model ended: {death.message}", where=where)


def _log_file() -> Any:
    """Return a file for the messages of a process."""
    if hasattr(os, "memfd_create"):
        return os.fdopen(os.memfd_create("gsgen log", os.MFD_CLOEXEC), "w+b")
    return tempfile.TemporaryFile(prefix="gsgen-")


@final
class Channel:
    """The parent's end of one session in a confined process, for one thread at a time.

    Attributes:
        shared: Memory that holds the tensors of the session.
    """

    def __init__(
        self,
        *,
        child: _ChildProcess,
        socket: socket.socket,
        shared: SharedMemory,
        number: int,
        where: str,
        is_last: bool,
    ) -> None:
        self.shared = shared
        self._child, self._socket, self._number = child, socket, number
        self._session_location, self._is_last_session = where, is_last
        self._frame, self._is_pending = 0, False
        self._stop: Stop | None = None

    def ask(self, message: Message | None, action: str) -> Message:
        """Send a message, and return the reply; the process is killed at the time limit.

        Args:
            message: The message; None to await the reply to the opening of the session.
            action: What takes too long, in the error.

        Raises:
            RunFailed: The time or memory limit is reached, or ONNX Runtime failed.
            HostProcessFailed: The machine ended the process.
            GsgenError: The session cannot be opened.
        """
        self._is_pending = True
        try:
            self._socket.settimeout(self._child.limits.seconds)
            if message is not None:
                send(self._socket, message)
            if self._stop is not None and self._stop.requested:
                self.cancel()
            reply, _ = receive(self._socket)
        except TimeoutError:
            limit = f"{self._child.limits.seconds:g} s, the time limit (--timeout)"
            self._child.end(
                RunFailed(f"{action} takes more than {limit}", where=self._session_location)
            )
            reply = None
        except OSError:
            reply = None
        finally:
            self._is_pending = False
        if reply is None:
            raise self._child.death(self._session_location)
        if "error" in reply:
            raise error_of(reply)
        return reply

    def follow(self, stop: Stop) -> None:
        """Cancel pending runs when a stop is requested, and later ones until it is reset."""
        self._stop = stop
        stop.call(self.cancel)

    def run(self, changed: Iterable[str]) -> None:
        """Compute a frame with the inputs in shared memory; ``changed`` names those that differ."""
        self._frame += 1
        self.ask({"frame": self._frame, "changed": list(changed)}, "a frame")

    def cancel(self) -> None:
        """End the session's pending run from another thread, or the process if it does not end."""
        if self._is_pending:
            self._child.stop_frame(self._number, self._frame)
            timer = threading.Timer(_STOP_SECONDS, self._kill_pending, (self._frame,))
            timer.daemon = True
            timer.start()

    def _kill_pending(self, frame: int) -> None:
        if self._is_pending and self._frame == frame:
            self._child.end(RunFailed("the run was stopped", where=self._session_location))

    def close(self) -> None:
        """End the session."""
        self._socket.close()
        if self._is_last_session:
            self._child.end()
