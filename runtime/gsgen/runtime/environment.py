"""What `gsgen doctor` asks of the graphics surroundings, and for files of splats."""

__all__ = ["checks"]

import json
import subprocess
import sys
from collections.abc import Iterator

from gsgen.contract.environment import Check, package

_SECONDS = 60
_PURPOSE = "draw; graph capture"
_DRIVERS = "install a Vulkan driver; without a GPU, `make drivers` in the project, or Mesa 25 or newer"

# In a child process: a driver that crashes must not take the doctor down.
_LIST = """
import json, wgpu
print(json.dumps([dict(a.info) for a in wgpu.gpu.enumerate_adapters_sync()], default=str))
"""


def checks() -> Iterator[Check]:
    """Yield the state of what drawing needs, and some file formats."""
    wgpu = package("wgpu", "pip install 'gsgen[runtime]'", purpose="draw")
    yield wgpu
    if wgpu.state == "ok":
        yield from _adapters()
    remedy = "pip install 'gsgen[formats]'"
    yield package("pillow", remedy, purpose="read SOG; write pictures")
    yield package("zstandard", remedy, purpose="SPZ version 4")
    yield package("trimesh", "pip install 'gsgen[runtime]'", purpose="read meshes")


def _adapters() -> Iterator[Check]:
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", _LIST],
            capture_output=True,
            text=True,
            timeout=_SECONDS,
        )
    except subprocess.TimeoutExpired:
        yield Check(
            "adapters", "broken", f"no answer after {_SECONDS} s", _DRIVERS, _PURPOSE
        )
        return
    if done.returncode != 0:
        tail = done.stderr.strip().splitlines()[-1:] or [f"exit status {done.returncode}"]
        yield Check("adapters", "broken", tail[0], _DRIVERS, _PURPOSE)
        return
    adapters = json.loads(done.stdout.strip().splitlines()[-1])
    if not adapters:
        yield Check("adapters", "missing", "no graphics adapter", _DRIVERS, _PURPOSE)
    for adapter in adapters:
        name, kind = adapter.get("device", "?"), adapter.get("adapter_type", "?")
        detail = f"{name} ({kind}, {adapter.get('backend_type', '?')}) {adapter.get('description', '')}"
        yield Check("adapter", "ok", detail.strip(), purpose=_PURPOSE)
