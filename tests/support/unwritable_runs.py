"""Runs commands whose outputs go to a full disk, a read-only one, and a folder without permission.

The disks are small file systems in memory, which no other process sees; they need no privilege where
Linux lets users make namespaces.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from support.commands import ROOT, Ran, gsgen_here

FULL_DISK: Final = "full"
READ_ONLY_DISK: Final = "read-only"
LOCKED_FOLDER: Final = "locked"

# The first namespace may mount; in the second one the process has no privileges, so that the
# permissions of a folder hold for root, too.
_MOUNT_SCRIPT: Final = f"""
mount -t tmpfs -o size=4k,mode=0777 none {FULL_DISK} &&
head -c 4096 /dev/zero > {FULL_DISK}/filler &&
mount -t tmpfs -o ro none {READ_ONLY_DISK} &&
exec unshare --user "$@"
"""
_UNSHARE: Final = ("unshare", "--user", "--map-root-user", "--mount")


def can_mount() -> bool:
    """Return whether this system lets the user mount file systems in a namespace."""
    words = [*_UNSHARE, "mount", "-t", "tmpfs", "none", "/mnt"]
    try:
        return subprocess.run(words, capture_output=True).returncode == 0
    except FileNotFoundError:  # no program of this name, as on macOS
        return False


def run_commands(folder: Path, commands: Sequence[Sequence[str]]) -> list[Ran]:
    """Run commands one after another in ``folder``, where the disks are."""
    for name in (FULL_DISK, READ_ONLY_DISK):
        (folder / name).mkdir()
    (folder / LOCKED_FOLDER).mkdir(mode=0o555)
    python_words = [sys.executable, "-m", "support.unwritable_runs", json.dumps(commands)]
    finished = subprocess.run(
        [*_UNSHARE, "sh", "-c", _MOUNT_SCRIPT, "sh", *python_words],
        cwd=folder,
        env=_environment(),
        capture_output=True,
        text=True,
    )
    assert finished.returncode == 0, finished.stderr
    return [Ran(**run) for run in json.loads(finished.stdout)]


def _environment() -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT / "tests"), "GSGEN_NO_CACHE": "1"}


def _main() -> None:
    runs = [gsgen_here(*words) for words in json.loads(sys.argv[1])]
    left_files = [
        str(path) for path in Path(FULL_DISK).rglob("*") if path.is_file() and path.name != "filler"
    ]
    assert not left_files, left_files
    print(json.dumps([{"code": run.code, "out": run.out, "err": run.err} for run in runs]))


if __name__ == "__main__":
    _main()
