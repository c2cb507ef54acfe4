"""Checks of `gsgen doctor`: graphics drivers, windows, and packages for file formats."""

__all__ = ["checks"]

import json
import subprocess
from collections.abc import Iterator
from functools import partial

from gsgen.contract.process.parent_watchdog import python_command
from gsgen.contract.tools.doctor import Check, check_package

_TIMEOUT_SECONDS = 60  # seconds
_RENDER_PURPOSE = "draw; graph capture"
_WINDOW_PURPOSE = "windows of `gsgen view`"
_NOTEBOOK_PURPOSE = "`gsgen.runtime.view` in notebooks"
_SOFTWARE_DRIVERS = (
    "install a Vulkan driver; without a GPU, `make drivers` in the project, or Mesa 25 or newer"
)
_RUNTIME_INSTALL_HINT = "pip install 'gsgen[runtime]'"

# These run in a child process: a driver that crashes must not end the doctor.
_LIST_ADAPTERS_SCRIPT = """
import json, wgpu
print(json.dumps([dict(a.info) for a in wgpu.gpu.enumerate_adapters_sync()], default=str))
"""
_EXPLAIN_RENDERER = """
import json
from gsgen.runtime.gpu.device import Device
from gsgen.runtime.renderer.rasteriser_choice import describe_choice
device = Device.open()
print(json.dumps(f"{device.name}: {describe_choice(device)}"))
"""
_WINDOW_TEST_SCRIPT = """
import json
from gsgen.runtime.errors import DisplayUnavailable
from gsgen.runtime.viewer.window import require_display
try:
    require_display()
    print(json.dumps(None))
except DisplayUnavailable as error:
    print(json.dumps(error.message))
"""


def checks() -> Iterator[Check]:
    """Yield the state of each package, driver and screen that drawing needs."""
    wgpu = check_package("wgpu", _RUNTIME_INSTALL_HINT, purpose="draw")
    yield wgpu
    if wgpu.state == "ok":
        yield from _check_adapters()
    windows = [
        check_package(name, _RUNTIME_INSTALL_HINT, purpose=_WINDOW_PURPOSE)
        for name in ("glfw", "rendercanvas")
    ]
    yield from windows
    if all(check.state == "ok" for check in windows):
        yield _check_screen()
    yield _widget()
    install_command = "pip install 'gsgen[formats]'"
    yield check_package("pillow", install_command, purpose="read SOG; write pictures")
    yield check_package("zstandard", install_command, purpose="SPZ version 4")
    yield check_package("trimesh", _RUNTIME_INSTALL_HINT, purpose="read meshes")


def _check_adapters() -> Iterator[Check]:
    adapters = _child_result("adapters", _LIST_ADAPTERS_SCRIPT, _SOFTWARE_DRIVERS, _RENDER_PURPOSE)
    if isinstance(adapters, Check):
        yield adapters
        return
    if not isinstance(adapters, list) or not adapters:
        yield Check(
            name="adapters",
            state="missing",
            detail="no graphics adapter was found",
            remedy=_SOFTWARE_DRIVERS,
            purpose=_RENDER_PURPOSE,
        )
        return
    for adapter in adapters:
        name, kind, backend_name = (
            adapter.get(key, "?") for key in ("device", "adapter_type", "backend_type")
        )
        detail = f"{name} ({kind}, {backend_name}) {adapter.get('description', '')}"
        yield Check(name="adapter", state="ok", detail=detail.strip(), purpose=_RENDER_PURPOSE)
    choice = _child_result("renderer", _EXPLAIN_RENDERER, _SOFTWARE_DRIVERS, _RENDER_PURPOSE)
    if not isinstance(choice, Check):
        choice = Check(name="renderer", state="ok", detail=str(choice), purpose=_RENDER_PURPOSE)
    yield choice


def _check_screen() -> Check:
    """Check whether a window can be opened on this machine."""
    problem = _child_result("screen", _WINDOW_TEST_SCRIPT, _RUNTIME_INSTALL_HINT, _WINDOW_PURPOSE)
    if isinstance(problem, Check):
        return problem
    if problem is None:
        return Check(
            name="screen", state="ok", detail="windows can be opened", purpose=_WINDOW_PURPOSE
        )
    return Check(
        name="screen",
        state="missing",
        detail=str(problem),
        remedy="draw without a screen: `gsgen render`",
        purpose=_WINDOW_PURPOSE,
    )


def _widget() -> Check:
    """Check the packages for views in notebooks: rendercanvas needs anywidget or jupyter_rfb."""
    install_command = "pip install anywidget"
    widgets = [
        check_package(n, install_command, purpose=_NOTEBOOK_PURPOSE)
        for n in ("anywidget", "jupyter_rfb")
    ]
    return next((check for check in widgets if check.state == "ok"), widgets[0])


def _child_result(name: str, code: str, install_command: str, purpose: str) -> object:
    """Return the JSON that ``code`` prints in a child process, or a failed check."""
    failed_check = partial(
        Check, name=name, state="broken", remedy=install_command, purpose=purpose
    )
    try:
        finished_process = subprocess.run(
            [*python_command(), "-c", code],
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_TIMEOUT_SECONDS,
        )
    except subprocess.TimeoutExpired:
        return failed_check(detail=f"no answer after {_TIMEOUT_SECONDS} s")
    if finished_process.returncode != 0:
        last_line = finished_process.stderr.strip().splitlines()[-1:] or [
            f"exit status {finished_process.returncode}"
        ]
        return failed_check(detail=last_line[0])
    result: object = json.loads(finished_process.stdout.strip().splitlines()[-1])
    return result
