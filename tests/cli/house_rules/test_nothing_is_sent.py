"""No command reports its use: no name is looked up, no socket connects, no file waits to be sent."""

import subprocess
import sys
from pathlib import Path

import pytest

from gsgen.conformance.fixtures import find
from gsgen.formats import write_ply
from support.no_network import clean_environment, run_offline
from support.splat_files import scene

GSGEN = (sys.executable, "-P", "-m", "gsgen.cli")
COMMANDS: dict[str, tuple[str, ...]] = {
    "validate": ("validate", "drift.onnx"),
    "float16": ("float16", "drift.onnx", "-o", "half.onnx", "--keep-outputs"),
    "bake": ("bake", "drift.onnx", "-o", "frame.ply", "--time", "0.5"),
    "render a generator": ("render", "drift.onnx", "-o", "model.png", "--width", "32", "--height", "24"),
    "render splats": ("render", "splats.ply", "-o", "splats.png", "--width", "32", "--height", "24"),
    "validate live": ("validate", "drift.onnx", "--level", "live"),
}  # fmt: skip
# Files that commands keep in the home on purpose: pipelines that graphics drivers compiled.
PURPOSEFUL_FOLDERS = (".cache/mesa_shader_cache",)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    find("drift").write(tmp_path)
    write_ply(tmp_path / "splats.ply", scene(count=50, degree=0))
    return tmp_path


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.slow if "live" in name else ()) for name in COMMANDS],
)
def test_command_sends_and_stores_nothing(name: str, folder: Path) -> None:
    done = run_offline(*GSGEN, *COMMANDS[name], folder=folder)
    assert done.code == 0, done.output
    assert done.packets == {}
    assert [file for file in done.home_files if not file.startswith(PURPOSEFUL_FOLDERS)] == []


@pytest.mark.parametrize(
    "attempt",
    [
        "socket.getaddrinfo('example.org', 443)",
        "socket.create_connection(('192.0.2.1', 443), 1)",
        "socket.socket(type=socket.SOCK_DGRAM).sendto(b'', ('192.0.2.1', 53))",
    ],
)
def test_attempt_to_reach_the_network_is_counted(attempt: str, tmp_path: Path) -> None:
    script = f"import socket\ntry: {attempt}\nexcept OSError: pass"
    assert run_offline(sys.executable, "-c", script, folder=tmp_path).packets


def test_telemetry_that_the_user_switches_on_is_seen(folder: Path) -> None:
    pytest.importorskip("onnxruntime", "1.31", reason="older releases report nothing")
    environment = {"ORT_DISABLE_TELEMETRY": "0"}
    command = (*GSGEN, *COMMANDS["float16"])  # a confined process could not write it
    done = run_offline(*command, folder=folder, environment=environment)
    assert any("onnxruntime" in file for file in done.home_files)


@pytest.mark.parametrize("variable", ["ORT_DISABLE_TELEMETRY", "HF_HUB_DISABLE_TELEMETRY"])
@pytest.mark.parametrize(
    "package", ["gsgen", "gsgen.contract.spec", "gsgen.formats", "gsgen.tiles"]
)
@pytest.mark.parametrize(("user_value", "expected"), [(None, "1"), ("0", "0"), ("", "")])
def test_importing_any_package_sets_the_variable_unless_the_user_did(
    variable: str, package: str, user_value: str | None, expected: str
) -> None:
    user_setting = {} if user_value is None else {variable: user_value}
    script = f"import {package}, os; print(os.environ[{variable!r}])"
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        env=clean_environment() | user_setting,
        check=True,
    )
    assert done.stdout.strip() == expected
