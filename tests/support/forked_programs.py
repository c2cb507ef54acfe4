"""Programs that pages type, forked from a process that has imported the libraries they need.

To start Python and import what `gsgen` draws or exports with takes from one second to seven; a
fork takes a hundredth of one. :func:`program_folder` writes `gsgen`, `python` and `pytest` into a
folder for the PATH. Each connects to the process, which forks and runs the program with the
client's arguments, folder, environment and standard streams.
"""

__all__ = ["program_folder"]

import atexit
import gc
import io
import json
import os
import runpy
import select
import socket
import subprocess
import sys
import threading
import traceback
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

_CLIENT = Path(__file__).with_name("program_client.py")
# Libraries, and modules that users' commands and scripts import when they are first needed.
_IMPORTED = (
    "numpy",
    "onnx",
    "onnxruntime",
    "PIL.Image",
    "scipy.spatial",
    "wgpu.backends.auto",
    "torch",
    "rich.progress",
    "gsgen.contract.tools.batch",
    "gsgen.contract.validator",
    "gsgen.formats",
    "gsgen.runtime.checks.viewer_kit",
    "gsgen.runtime.playback.frame_sequence",
    "gsgen.runtime.playback.playback",
    "gsgen.runtime.playback.scene_camera",
    "gsgen.sdk.binding.session",
    "gsgen.sdk.exporting.exporter",
    "gsgen.tiles.build.build",
    "gsgen.tiles.scoring.score",
    "gsgen.tiles.streaming.tiles_source",
    "gsgen.tiles.validation.validate",
    "gsgen.tiles.validation.rules",
    "torch.onnx._internal.exporter._core",
    "torch.export._trace",
    "onnxscript.function_libs.torch_lib.ops",
)
# What a test of ours imports that runs pytest. Its plugins are left out: pytest rewrites them.
_IMPORTED_FOR_PYTEST = (
    "_pytest.config",
    "_pytest.junitxml",
    "_pytest.python",
    "_pytest.terminal",
    "numpy",
    "onnx",
    "gsgen.conformance.reproduction",
    "gsgen.conformance.suite",
    "gsgen.contract.validator",
)
_MODULES = ("gsgen.cli", "pytest", "support.printed_commands")
_MOST_REQUEST_BYTES = 1 << 20


@contextmanager
def program_folder(folder: Path, *, for_pytest: bool = False) -> Iterator[Path]:
    """Yield a folder with programs whose processes are forked until the exit.

    `python` is forked with scripts, and with `-m` and some modules; or, for fewer imports, with
    `-m pytest` alone.
    """
    socket_path = folder / "socket"
    modules = ("pytest",) if for_pytest else _MODULES
    for name in ("gsgen", "python", "pytest"):
        program = folder / name
        real = sys.executable if name == "python" else Path(sys.executable).with_name(name)
        words = (str(real), str(socket_path), _surroundings(), modules)
        call = f"serve_or_replace{words!r}"
        program.write_text(f"#!{sys.executable} -IS\n{_CLIENT.read_text('utf-8')}\n{call}\n")
        program.chmod(0o755)
    server = subprocess.Popen(
        [sys.executable, "-P", __file__, str(socket_path), *(["pytest"] if for_pytest else [])],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert server.stdout is not None
        assert server.stdout.readline() == "ready\n"
        yield folder
    finally:
        server.terminate()
        server.communicate()


def _surroundings() -> dict[str, str]:
    """Return the variables that change what Python imports; programs with others are not forked."""
    names = [name for name in os.environ if name.startswith("PYTHON") and "IOENCODING" not in name]
    return {name: os.environ[name] for name in names}


def _serve(path: str) -> "tuple[socket.socket, dict[str, Any], list[int]] | None":
    """Accept clients; return in each forked child with its client's request."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind(path)
    listener.listen(16)
    print("ready", flush=True)
    clients: dict[int, tuple[int, socket.socket]] = {}  # by the descriptor of the child
    while True:
        for readable in select.select([listener, *clients], [], [])[0]:
            if readable is not listener:
                child, client = clients.pop(readable)
                _, status = os.waitpid(child, 0)
                os.close(readable)
                with client:
                    client.send(str(os.waitstatus_to_exitcode(status)).encode())
                continue
            client, _ = listener.accept()
            message, descriptors, _, _ = socket.recv_fds(client, _MOST_REQUEST_BYTES, 3)
            child = os.fork()
            if child == 0:
                listener.close()
                return client, json.loads(message), descriptors
            for descriptor in descriptors:
                os.close(descriptor)
            client.send(str(child).encode())
            clients[os.pidfd_open(child)] = (child, client)


def _become(request: dict[str, Any], descriptors: list[int]) -> None:
    """Give this process the folder, the environment and the streams of a client."""
    for number, descriptor in enumerate(descriptors):
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["folder"])
    sys.argv = request["arguments"]
    sys.executable = request["python"]  # whose processes are forks, too
    _find_packages(os.environ.get("PYTHONPATH", ""))
    encoding = os.environ.get("PYTHONIOENCODING", "utf-8")
    reader = io.BufferedReader(io.FileIO(0, closefd=False))
    sys.stdin = sys.__stdin__ = io.TextIOWrapper(reader, encoding)  # type: ignore[misc]
    streams = [
        io.TextIOWrapper(
            io.BufferedWriter(io.FileIO(number, "w", closefd=False)),
            encoding,
            errors,
            line_buffering=number == 2 or os.isatty(number),
        )
        for number, errors in ((1, "strict"), (2, "backslashreplace"))
    ]
    sys.stdout, sys.stderr = sys.__stdout__, sys.__stderr__ = streams  # type: ignore[misc]


def _find_packages(python_path: str) -> None:
    """Let a fork import what its PYTHONPATH has, and find what is registered there."""
    folders = [folder for folder in python_path.split(os.pathsep) if folder]
    added = [str(Path(folder).resolve()) for folder in folders]
    added = [folder for folder in added if folder not in sys.path]
    if not added:
        return
    sys.path[:0] = added
    if not any(list(Path(folder).glob("*.dist-info")) for folder in added):
        return
    for module in [module for name, module in sys.modules.items() if name.startswith("gsgen.")]:
        for function in vars(module).values():
            if hasattr(function, "cache_clear"):
                function.cache_clear()
    sys.modules.pop("gsgen.sdk.commands.export", None)  # which lists plugins when it is imported


def _run(program: str) -> int:
    """Run `gsgen`, `pytest`, or a script as the interpreter would, and return the exit code."""
    try:
        if program == "gsgen":
            sys.modules["__main__"] = ModuleType("__main__")  # which spawned processes import
            from gsgen.cli import main

            main()
        elif program == "pytest":
            sys.modules["__main__"] = ModuleType("__main__")
            sys.path.insert(0, str(Path(sys.argv[0]).parent))
            import pytest

            return int(pytest.console_main())
        elif sys.argv[0] == "-m":
            module = sys.argv[1]
            del sys.argv[:1]
            sys.path.insert(0, str(Path.cwd()))
            runpy.run_module(module, run_name="__main__", alter_sys=True)
        else:
            script = Path(sys.argv[0]).resolve()
            sys.path.insert(0, str(script.parent))
            runpy.run_path(str(script), run_name="__main__")
    except SystemExit as ended:
        if isinstance(ended.code, str):
            print(ended.code, file=sys.stderr)
        return ended.code if isinstance(ended.code, int) else int(ended.code is not None)
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def _end(code: int) -> None:
    """End a forked process as the interpreter ends, without freeing all that was imported."""
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _import_libraries() -> None:
    for name in _IMPORTED:
        import_module(name)
    from gsgen.contract._extensions import find_commands
    from gsgen.runtime.gpu.native_types import parse_native_types

    parse_native_types()
    for command in find_commands().values():
        command.load()
    _make_tables_of_operators()
    _share_sandbox()
    # It is a plugin of pytest, too: unmarked, pytest would warn that it cannot rewrite it any more.
    sys.modules["jaxtyping"].__doc__ = "PYTEST_DONT_REWRITE"
    for finalizer in list(weakref.finalize._registry):  # type: ignore[attr-defined]
        finalizer.atexit = False  # torch's, which free what ends with the process


def _import_for_pytest() -> None:
    for name in _IMPORTED_FOR_PYTEST:
        import_module(name)
    from gsgen.contract.rules.catalogue import builtin_rules

    builtin_rules()
    _share_sandbox()


@contextmanager
def _tests_on_path() -> Iterator[None]:
    """Find modules of the tests here; a reader's program finds none."""
    tests = str(Path(__file__).parents[1])
    sys.path.insert(0, tests)
    yield
    sys.path.remove(tests)


def _share_sandbox() -> None:
    """Let models of all programs run in forks of one process, too."""
    from gsgen.contract.probing import sandbox

    with _tests_on_path():
        from support.forked_sandbox import run_forked, share_with_forks
    sandbox._run_child = run_forked
    share_with_forks()


def _make_tables_of_operators() -> None:
    """Make torch's tables for exports, which every program that exports would make anew."""
    import pytest
    from torch._export import utils
    from torch.onnx._internal.exporter import _constants, _registration

    with _tests_on_path():
        from support.reports.one_registry import share_operators
    share_operators(pytest.MonkeyPatch())
    _registration.ONNXRegistry.from_torchlib(opset_version=_constants.TORCHLIB_OPSET)
    utils._collect_all_valid_cia_ops()


if __name__ == "__main__":
    _import_for_pytest() if sys.argv[2:] == ["pytest"] else _import_libraries()
    gc.freeze()
    accepted = _serve(sys.argv[1])
    if accepted is not None:
        _client, _request, _descriptors = accepted
        _client.close()
        _become(_request, _descriptors)
        _end(_run(_request["program"]))
