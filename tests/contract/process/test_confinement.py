"""A confined process cannot read the home, reach the network, start processes or fill a disk."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from gsgen.contract.process.confinement import available_confinement
from gsgen.contract.process.system_call_filter import _filter_program

# Tries each statement, and prints the class of its error, or an empty text.
_TRY = """
import json, sys
from pathlib import Path
from gsgen.contract.process.confinement import confine
readable, writable, *statements = json.loads(sys.argv[1])
confine([Path(readable)], [Path(writable)], file_bytes=1 << 20)
errors = {}
for statement in statements:
    try:
        exec(statement, {"readable": readable, "writable": writable})
        errors[statement] = ""
    except BaseException as error:
        errors[statement] = type(error).__name__
print(json.dumps(errors))
"""
NEEDS_FILES = pytest.mark.skipif(not available_confinement().files, reason="no Landlock here")
NEEDS_CALLS = pytest.mark.skipif(not available_confinement().calls, reason="no seccomp here")


def errors_of(folder: Path, *statements: str) -> dict[str, str]:
    """Return the error's class of each statement in a confined process whose home is ``folder``."""
    home, writable, model = folder / "home", folder / "spool", folder / "home" / "model.onnx"
    for new_folder in (home, writable):
        new_folder.mkdir()
    model.write_text("weights")
    (home / "secret").write_text("secret")
    completed = subprocess.run(
        [sys.executable, "-c", _TRY, json.dumps([str(model), str(writable), *statements])],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"HOME": str(home)},
    )
    return dict(json.loads(completed.stdout))


@NEEDS_FILES
def test_a_confined_process_reads_its_model_and_no_other_file_of_the_home(tmp_path: Path) -> None:
    denied = (
        "import os; os.listdir(os.environ['HOME'])",
        "import os; open(os.environ['HOME'] + '/secret')",
        "import os; open(os.environ['HOME'] + '/new', 'w')",
        "open(readable, 'a')",
        "import os; os.unlink(readable)",
        "open('/etc/passwd')",
        "import os; open(f'/proc/{os.getppid()}/environ').read(1)",
        "import os; open(f'/proc/{os.getppid()}/mem', 'rb').read(1)",
    )
    allowed = ("open(readable).read()", "import os; os.listdir(os.__file__.rpartition('/')[0])")
    errors = errors_of(tmp_path, *denied, *allowed)
    assert {errors[statement] for statement in denied} == {"PermissionError"}
    assert [errors[statement] for statement in allowed] == ["", ""]


@NEEDS_FILES
def test_a_confined_process_writes_small_files_to_its_folder_alone(tmp_path: Path) -> None:
    errors = errors_of(
        tmp_path,
        "open(writable + '/small', 'wb').write(bytes(1 << 20))",
        "open(writable + '/large', 'wb').write(bytes(2 << 20))",
        "open(writable + '/../beside', 'w')",
        "open('/tmp/gsgen-confined', 'w')",
        "open('/dev/shm/gsgen-confined', 'w')",
        "open('/dev/null', 'w').write('a')",
    )
    assert list(errors.values()) == ["", "OSError", *("PermissionError",) * 3, ""]
    assert (tmp_path / "spool" / "large").stat().st_size == 1 << 20


@NEEDS_CALLS
@pytest.mark.parametrize(
    "statement",
    [
        "import socket; socket.socket(socket.AF_INET).connect(('127.0.0.1', 1))",
        "import socket; socket.socket(socket.AF_INET, socket.SOCK_DGRAM)",
        "import socket; socket.socket(socket.AF_UNIX)",
        "import os; os.fork()",
        "import os; os.posix_spawn('/bin/true', ['true'], {})",
        "import os; os.execv('/bin/true', ['true'])",
        "import subprocess; subprocess.run(['/bin/true'])",
        "import os, signal; os.kill(os.getppid(), 0)",
    ],
)
def test_a_confined_process_reaches_no_network_and_no_process(
    tmp_path: Path, statement: str
) -> None:
    assert errors_of(tmp_path, statement)[statement] == "PermissionError"


@NEEDS_CALLS
def test_a_confined_process_starts_threads(tmp_path: Path) -> None:
    statement = (
        "import threading; t = threading.Thread(target=len, args=('',)); t.start(); t.join()"
    )
    assert errors_of(tmp_path, statement)[statement] == ""


@pytest.mark.parametrize("machine", ["x86_64", "aarch64"])
def test_every_jump_of_the_filter_leads_to_an_instruction(machine: str) -> None:
    program = [
        (int.from_bytes(code[:2], sys.byteorder), code[2], code[3])
        for code in _filter_program(machine)
    ]
    for index, (operation, if_true, if_false) in enumerate(program):
        if operation & 0x07 == 0x05:  # a jump
            assert index + 1 + max(if_true, if_false) < len(program)
    assert program[-1][0] == 0x06  # returns
