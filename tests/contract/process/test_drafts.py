"""A folder of a killed process is removed by a later one; a folder whose owner lives is not."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from gsgen.contract.process import drafts
from gsgen.contract.process.drafts import sweep_drafts, temporary_folder
from support.commands import ROOT

OWNER_SCRIPT = (
    "import sys, time\n"
    "from pathlib import Path\n"
    "from gsgen.contract.process.drafts import temporary_folder\n"
    "with temporary_folder(Path(sys.argv[1])) as folder:\n"
    "    (folder / 'deep').mkdir()\n"
    "    (folder / 'deep' / 'half').write_text('half')\n"
    "    print(folder, flush=True)\n"
    "    time.sleep(10_000)\n"
)


@contextmanager
def owner(parent: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """Start a process that owns a draft in ``parent``."""
    words = [sys.executable, "-c", OWNER_SCRIPT, str(parent)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, Path(process.stdout.readline().strip())
        finally:
            process.kill()


def test_draft_of_a_killed_process_is_removed(tmp_path: Path) -> None:
    with owner(tmp_path) as (process, draft):
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert (draft / "deep" / "half").exists()
    with temporary_folder(tmp_path) as folder:
        assert list(tmp_path.iterdir()) == [folder]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("is_stopped", [False, True])
def test_draft_of_a_living_process_stays(tmp_path: Path, *, is_stopped: bool) -> None:
    with owner(tmp_path) as (process, draft):
        if is_stopped:
            process.send_signal(signal.SIGSTOP)
        assert sweep_drafts(tmp_path) == 0
        assert (draft / "deep" / "half").exists()


def test_own_drafts_stay(tmp_path: Path) -> None:
    with temporary_folder(tmp_path) as first, temporary_folder(tmp_path) as second:
        assert sweep_drafts(tmp_path) == 0
        assert first.is_dir()
        assert second.is_dir()


@pytest.mark.parametrize(
    "name",
    ["gsgen-abcdefgh", ".gsgen-0011223344556677.part.txt", "x.gsgen-0011223344556677.part",
     ".result.part", "gsgen-models"],
)  # fmt: skip
def test_folders_of_other_names_stay(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    assert sweep_drafts(tmp_path) == 0
    assert (tmp_path / name).is_dir()


def test_link_with_the_name_of_a_draft_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "target").mkdir()
    (tmp_path / "target" / "kept").touch()
    (tmp_path / ".gsgen-0011223344556677.part").symlink_to(tmp_path / "target")
    assert sweep_drafts(tmp_path) == 0
    assert (tmp_path / "target" / "kept").exists()


def test_folder_swept_before_it_was_locked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process may look for drafts just between the making and the locking of one."""
    lock, swept = drafts.lock_folder, []

    def sweep_first(draft: Path) -> int | None:
        if not swept:
            swept.append(draft)
            draft.rmdir()
        return lock(draft)

    monkeypatch.setattr(drafts, "lock_folder", sweep_first)
    with temporary_folder(tmp_path) as folder:
        assert folder.is_dir()
        assert swept != [folder]


def test_without_locks_nothing_is_swept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fcntl", None)  # as on Windows
    stale = tmp_path / ".gsgen-0011223344556677.part"
    stale.mkdir()
    with temporary_folder(tmp_path) as folder:
        assert folder.is_dir()
    assert list(tmp_path.iterdir()) == [stale]


def test_folder_that_cannot_be_listed_is_no_error() -> None:
    assert sweep_drafts(Path("/proc/self/absent")) == 0


def test_all_temporary_folders_are_drafts() -> None:
    """Only what :mod:`gsgen.contract.process.drafts` makes is recognised by later processes."""
    pattern = re.compile(
        r"tempfile\.(?!TemporaryFile\b|gettempdir\b)|from tempfile import (?!TemporaryFile\b)"
    )
    packages = [ROOT / name for name in ("contract", "sdk", "runtime", "reference_plugins")]
    modules = [path for package in packages for path in package.rglob("*.py")]
    modules = [path for path in modules if path.name != "drafts.py"]
    assert len(modules) > 500
    makers = [str(path) for path in modules if pattern.search(path.read_text("utf-8"))]
    assert makers == []


def test_drafts_are_readable_by_their_owner_alone(tmp_path: Path) -> None:
    with temporary_folder(tmp_path) as folder:
        assert os.stat(folder).st_mode & 0o777 == 0o700
