"""Temporary folders whose owner may be killed: a later process removes what it left.

The owner of a folder holds a lock on it (``flock``), which the system releases when the process ends,
however it ends. So a folder of ours without a lock has no owner. Where the system or the file system
has no such locks (Windows, some network drives), nothing is removed.
"""

__all__ = ["remove_own_drafts", "sweep_drafts", "temporary_folder"]

import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

_NAME_PATTERN: Final = re.compile(r"\.?gsgen-[0-9a-f]{16}\.part")

# The folders of this process → descriptor that holds the lock; None without locks.
_own_drafts: dict[Path, int | None] = {}
_cleaned_draft_folders: set[Path] = set()


@contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """Make a folder that is removed after the block, or by a later process if this one is killed.

    The first folder that a process makes in ``parent`` removes those without an owner there.

    Args:
        parent: The folder that holds it, where its name is hidden; None for that of the system,
            which the environment variable TMPDIR names.

    Raises:
        OSError: The folder cannot be made.
    """
    prefix = "gsgen-" if parent is None else ".gsgen-"
    holding_folder = Path(tempfile.gettempdir()) if parent is None else parent.absolute()
    if holding_folder not in _cleaned_draft_folders:
        _cleaned_draft_folders.add(holding_folder)
        sweep_drafts(holding_folder)
    draft = _make_locked_draft(holding_folder, prefix)
    try:
        yield draft
    finally:
        _remove_draft(draft)


def sweep_drafts(folder: Path) -> int:
    """Remove the temporary folders in ``folder`` that processes left when they were killed.

    Returns:
        How many were removed.
    """
    removed_draft_count = 0
    with suppress(OSError), os.scandir(folder) as entries:
        stale_names = [entry.name for entry in entries if _NAME_PATTERN.fullmatch(entry.name)]
        for name in stale_names:
            removed_draft_count += _remove_ownerless_draft(folder / name)
    return removed_draft_count


def remove_own_drafts() -> None:
    """Remove all temporary folders of this process: for a process that ends at once."""
    for draft in list(_own_drafts):
        _remove_draft(draft)


def _make_locked_draft(holding_folder: Path, prefix: str) -> Path:
    while True:
        draft = holding_folder / f"{prefix}{secrets.token_hex(8)}.part"
        draft.mkdir(mode=0o700)
        try:
            descriptor = lock_folder(draft)
        except (BlockingIOError, FileNotFoundError):  # it was swept before it was locked
            continue
        _own_drafts[draft] = descriptor
        return draft


def _remove_draft(draft: Path) -> None:
    shutil.rmtree(draft, ignore_errors=True)  # on Windows, a file that is still mapped stays there
    descriptor = _own_drafts.pop(draft, None)
    if descriptor is not None:
        os.close(descriptor)


def _remove_ownerless_draft(draft: Path) -> bool:
    try:
        descriptor = lock_folder(draft)
    except OSError:  # the owner lives, or another process removes it
        return False
    if descriptor is None:
        return False
    try:
        if os.fstat(descriptor).st_uid != os.geteuid():
            return False
        shutil.rmtree(draft, ignore_errors=True)
        return True
    finally:
        os.close(descriptor)


def lock_folder(folder: Path) -> int | None:
    """Lock a folder; return the descriptor that holds the lock, None without locks.

    Raises:
        BlockingIOError: Another process holds the lock.
        FileNotFoundError: The folder was removed.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        folder.stat()  # between opening and locking, another process may have removed it
    except (BlockingIOError, FileNotFoundError):
        os.close(descriptor)
        raise
    except OSError:  # the file system has no locks
        os.close(descriptor)
        return None
    return descriptor
