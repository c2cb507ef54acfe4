"""The code that runs on Windows alone, with a kernel that records its calls."""

import ctypes
import os
import threading
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import pytest

from gsgen.contract.probing import sandbox
from gsgen.contract.process import limits, parent_watchdog, windows


class Function:
    """A function of the Windows API, which records its arguments."""

    def __init__(self, kernel: "Kernel", name: str) -> None:
        self.kernel, self.name, self.restype = kernel, name, None

    def __call__(self, *arguments: Any) -> int:
        if self.name == "SetInformationJobObject":
            # The structure is read as Windows reads it: by offsets of the 64-bit layout.
            raw = ctypes.string_at(ctypes.addressof(arguments[2]._obj), arguments[3])
            flags = int.from_bytes(raw[16:20], "little")
            limit = int.from_bytes(raw[112:120], "little")
            arguments = (arguments[0], arguments[1], flags, limit, arguments[3])
        self.kernel.calls.append((self.name, arguments))
        return self.kernel.results.get(self.name, 7)


@dataclass
class Kernel:
    results: dict[str, int] = field(default_factory=dict)
    calls: list[tuple[str, tuple[Any, ...]]] = field(default_factory=list)

    def __getattr__(self, name: str) -> Function:
        function = Function(self, name)
        object.__setattr__(self, name, function)
        return function

    def names(self) -> list[str]:
        return [name for name, _ in self.calls]


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    kernel = Kernel()
    monkeypatch.setattr(ctypes, "WinDLL", lambda *_, **__: kernel, raising=False)
    monkeypatch.setattr(ctypes, "get_last_error", lambda: 5, raising=False)
    return kernel


def test_memory_is_limited_by_a_job_object(kernel: Kernel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "os", SimpleNamespace(name="nt"))
    limits.limit_memory(3 << 30)
    assert kernel.names() == [
        "CreateJobObjectW",
        "SetInformationJobObject",
        "GetCurrentProcess",
        "AssignProcessToJobObject",
    ]
    _, (_, kind, flags, limit, size) = kernel.calls[1]
    assert (kind, flags, limit, size) == (9, 0x500, 3 << 30, 144)


def test_a_limit_that_windows_refuses_is_an_error(kernel: Kernel) -> None:
    kernel.results["AssignProcessToJobObject"] = 0
    with pytest.raises(OSError, match="memory of this process: error 5"):
        windows.limit_commit(1 << 20)


def test_a_process_that_has_ended_is_not_waited_for(kernel: Kernel) -> None:
    kernel.results["OpenProcess"] = 0
    windows.wait_for_exit(42)
    assert kernel.calls == [("OpenProcess", (0x00100000, False, 42))]


@pytest.mark.parametrize(("variable", "process"), [({}, 11), ({"GSGEN_PARENT_PROCESS": "99"}, 99)])
def test_a_worker_ends_when_its_parent_does(
    kernel: Kernel, monkeypatch: pytest.MonkeyPatch, variable: dict[str, str], process: int
) -> None:
    ended, codes = threading.Event(), []

    def end(code: int) -> None:
        codes.append(code)
        ended.set()

    surroundings = SimpleNamespace(name="nt", environ=variable, getppid=lambda: 11, _exit=end)
    monkeypatch.setattr(parent_watchdog, "os", surroundings)
    parent_watchdog.exit_with_parent()
    assert ended.wait(5)
    assert codes == [1]
    assert kernel.calls[0] == ("OpenProcess", (0x00100000, False, process))
    assert kernel.names()[1:] == ["WaitForSingleObject"]


def test_a_child_knows_its_parent() -> None:
    assert parent_watchdog.child_environment()["GSGEN_PARENT_PROCESS"] == str(os.getpid())


def test_cores_are_counted_without_affinities(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "os", SimpleNamespace(cpu_count=lambda: 6))
    assert limits.available_cores() == 6
    monkeypatch.setattr(limits, "os", SimpleNamespace(cpu_count=lambda: None))
    assert limits.available_cores() == 1


def test_a_child_is_stopped_without_process_groups(monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    child = SimpleNamespace(
        pid=1,
        poll=lambda: None,
        kill=lambda: calls.append("kill"),
        wait=lambda: calls.append("wait"),
    )
    monkeypatch.setattr(sandbox, "os", SimpleNamespace(name="nt"))
    sandbox._stop_child(child)  # type: ignore[arg-type]
    assert calls == ["kill", "wait"]


def test_outputs_are_copied_where_a_mapped_file_cannot_be_deleted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Any
) -> None:
    import numpy as np

    np.save(tmp_path / "a.npy", np.arange(5))
    assert isinstance(sandbox._map_array(tmp_path / "a.npy"), np.memmap)
    monkeypatch.setattr(sandbox, "os", SimpleNamespace(name="nt"))
    array = sandbox._map_array(tmp_path / "a.npy")
    assert not isinstance(array, np.memmap)
    assert array.tolist() == [0, 1, 2, 3, 4]
