"""Proof that ``make fuzz-formats`` sees what it looks for."""

import json
import sys
import tempfile
import time
from pathlib import Path

import pytest

from fuzz import formats
from gsgen.formats import FileTruncated, SizeExceeded, Splats
from support.splat_files import scene

pytestmark = pytest.mark.slow


def reading(monkeypatch: pytest.MonkeyPatch, action: object) -> None:
    """Let every file be read by ``act``."""
    monkeypatch.setattr(formats, "open_splats", action)


def trial(tmp_path: Path) -> formats.Trial:
    file = tmp_path / "mutant"
    file.write_bytes(b"a")
    return formats.read(formats.ANY, file)


def test_read_and_refused_files_are_counted_separately(tmp_path, monkeypatch):
    reading(monkeypatch, lambda file: scene(1, 0))
    assert trial(tmp_path) == formats.Trial("read")

    def refuse(file: Path) -> Splats:
        raise FileTruncated("too short", path=str(file))

    reading(monkeypatch, refuse)
    assert trial(tmp_path) == formats.Trial("FileTruncated")


@pytest.mark.parametrize(
    ("error", "failure"),
    [
        (KeyError("no such thing"), "KeyError: 'no such thing'"),
        (MemoryError(), "MemoryError: "),
        (RuntimeWarning("divide by zero"), "RuntimeWarning: divide by zero"),
        (FileTruncated("too short"), "names no file: too short"),
        (FileTruncated("a\nb\nc\nd"), "names no file: a\nb\nc\nd"),
        (SizeExceeded("takes more memory than is available"), "memory ran out: takes more memory"),
    ],
)
def test_unexpected_exception_is_a_failure(tmp_path, monkeypatch, error, failure):
    def fail(file: Path) -> Splats:
        raise error

    reading(monkeypatch, fail)
    assert trial(tmp_path).failure.startswith(failure)


def test_an_endless_reader_is_stopped(tmp_path, monkeypatch):
    monkeypatch.setattr(formats, "SECONDS", 1)
    reading(monkeypatch, lambda file: time.sleep(60))
    formats.signal.signal(formats.signal.SIGALRM, formats._late)
    result = formats._timed(formats.ANY, tmp_path / "mutant")
    assert result == formats.Trial("late", "took more than 1 s")


def test_a_run_sums_up_and_fails_where_a_file_did(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(formats, "FOLDER", tmp_path / "kept")
    monkeypatch.setattr(
        "sys.argv", ["formats", "--count", "4", "--format", "splat", "--format", "spz"]
    )
    assert formats.main() == 0
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("splat: 4 files in ")
    assert ", 0 failed, " in first
    assert second.startswith("spz: 4 files in ")
    assert not (tmp_path / "kept").exists()


def test_a_process_that_dies_is_seen_and_its_file_kept(tmp_path, monkeypatch, capsys):
    """The second of three files kills the process that reads it."""
    killer_script = tmp_path / "killer.py"
    killer_script.write_text(
        "import json, os, sys\n"
        "first = int(sys.argv[sys.argv.index('--first') + 1])\n"
        "for case in range(first, 3):\n"
        "    if case == 1:\n"
        "        os.abort()\n"
        "    told = {'case': case, 'kind': 'read', 'failure': '', 'peak': 0}\n"
        "    print(json.dumps(told), flush=True)\n"
    )
    run = formats.subprocess.run

    def instead(command: list[str], **options: object) -> object:
        words = [sys.executable, str(killer_script), *command[3:]]
        return run(words, **options)  # type: ignore[call-overload]

    monkeypatch.setattr(formats, "FOLDER", tmp_path / "kept")
    monkeypatch.setattr(formats.subprocess, "run", instead)
    assert formats._run("splat", 3, 0) == 1
    out = capsys.readouterr().out
    assert "1 failed" in out
    assert "splat 1: ended with -6" in out
    assert (tmp_path / "kept" / "splat-0-1").stat().st_size


def test_worker_reports_memory_excess(monkeypatch, capsys):
    monkeypatch.setattr(formats, "MEMORY", 1000)
    formats._tell(3, formats.Trial("read"), 2 << 20)
    document = json.loads(capsys.readouterr().out)
    assert document == {"case": 3, "kind": "read", "failure": "2 MiB of memory", "peak": 2 << 20}


def test_every_format_has_whole_files():
    with tempfile.TemporaryDirectory() as folder:
        whole = formats.whole_files(Path(folder))
    names = {codec.name for codec in formats_of_the_package()}
    assert names | {formats.ANY} == set(whole)


def formats_of_the_package() -> tuple:
    from gsgen.formats import CODECS

    return CODECS
