"""Runs commands in a network namespace without interfaces, and counts what they try to send."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

_FOLDER_VARIABLES = {
    "HOME": "home",
    "XDG_CACHE_HOME": "home/.cache",
    "XDG_CONFIG_HOME": "home/.config",
    "XDG_DATA_HOME": "home/.local/share",
    "XDG_STATE_HOME": "home/.local/state",
}

# The kernel counts, for each namespace, the packets that found no route, and those sent. Name
# look-ups and connections to any address but a local one end there.
_COUNT_SCRIPT = """
import json, subprocess, sys
from pathlib import Path

def sent():
    lines = Path("/proc/net/snmp").read_text().splitlines()
    counts = {}
    for keys, values in zip(lines[::2], lines[1::2]):
        counts |= {keys.split()[0] + key: int(value)
                   for key, value in zip(keys.split()[1:], values.split()[1:])}
    snmp6 = Path("/proc/net/snmp6")
    pairs = (line.split() for line in snmp6.read_text().splitlines()) if snmp6.exists() else ()
    counts |= {key: int(value) for key, value in pairs}
    return {key: count for key, count in counts.items()
            if key.endswith(("OutNoRoutes", "OutDatagrams", "OutRequests", "ActiveOpens"))}

before = sent()
done = subprocess.run(sys.argv[2:])
after = sent()
changes = {key: after[key] - before[key] for key in after if after[key] != before[key]}
Path(sys.argv[1]).write_text(json.dumps(changes))
sys.exit(done.returncode)
"""


@dataclass(frozen=True, slots=True)
class OfflineRun:
    """A command that ran without a network.

    Attributes:
        code: Its exit code.
        output: What it printed, errors included.
        packets: Counter of the kernel → packets and connections that it tried to send.
        home_files: The files that it left in its home folder, relative to it.
    """

    code: int
    output: str
    packets: dict[str, int]
    home_files: list[str]


def run_offline(
    *command: str, folder: Path, environment: Mapping[str, str] | None = None
) -> OfflineRun:
    """Run a command in an empty network namespace, with an empty folder as its home.

    Skips the test on systems where users cannot create namespaces.
    """
    require_namespaces()
    home = folder / "home"
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir()
    paths = {name: str(folder / path) for name, path in _FOLDER_VARIABLES.items()}
    record = folder / "packets.json"
    namespace = ["unshare", "--map-root-user", "--net", sys.executable, "-I", "-S", "-c"]
    completed = subprocess.run(
        [*namespace, _COUNT_SCRIPT, str(record), *command],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=folder,
        env=clean_environment() | paths | dict(environment or {}),
        timeout=300,
    )
    files = sorted(str(path.relative_to(home)) for path in home.rglob("*") if path.is_file())
    packets = json.loads(record.read_text())
    return OfflineRun(completed.returncode, completed.stdout, packets, files)


def clean_environment() -> dict[str, str]:
    """Return this process's environment without what `import gsgen` set in it, nor opt-outs.

    ONNX Runtime reports nothing where the variable CI says that a build server runs it.
    """
    reporting = ("TELEMETRY", "DO_NOT_TRACK", "CI")
    return {name: value for name, value in os.environ.items() if not name.endswith(reporting)}


def require_namespaces() -> None:
    """Skip a test where no unprivileged user may create a user and a network namespace."""
    if sys.platform != "linux" or shutil.which("unshare") is None:
        pytest.skip("network namespaces need Linux and the program unshare")
    trial = subprocess.run(
        ["unshare", "--map-root-user", "--net", "true"], capture_output=True, text=True
    )
    if trial.returncode:
        pytest.skip(f"users of this system cannot create namespaces: {trial.stderr.strip()}")
