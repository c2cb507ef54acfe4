"""Hundreds of calls that people type who know other tools: exit code, and file or hint."""

import shlex
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.commands import gsgen, gsgen_here
from support.natural_calls import natural_calls, natural_files

CALLS = natural_calls()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with natural_files(tmp_path_factory.mktemp("natural")) as folder:
        yield folder


@pytest.fixture
def new_files(folder: Path) -> Iterator[list[str]]:
    """Names of the files that a call wrote, which are removed after it."""
    before, names = set(folder.iterdir()), list[str]()
    yield names
    for path in set(folder.iterdir()) - before:
        shutil.rmtree(path) if path.is_dir() else path.unlink()


def words_of(call: str) -> list[str]:
    lexer = shlex.shlex(call, posix=True, punctuation_chars=False)
    lexer.whitespace_split, lexer.commenters = True, ""
    return list(lexer)


@pytest.mark.parametrize(("call", "code", "fragment"), CALLS, ids=[call for call, _, _ in CALLS])
def test_a_natural_call_is_answered(
    call: str, code: int, fragment: str, folder: Path, new_files: list[str]
) -> None:
    before = {path.name for path in folder.iterdir()}
    completed = gsgen_here(*words_of(call), cwd=folder)
    new_files += sorted({path.name for path in folder.iterdir()} - before)
    answer = completed.out + " ".join(completed.err.replace("│", " ").split())
    assert completed.code == code, completed
    assert fragment in answer or fragment in new_files, completed
    assert "Traceback" not in completed.err
    assert not new_files or code == 0, new_files


def test_enough_calls_are_tried() -> None:
    assert len({call for call, _, _ in CALLS}) == len(CALLS) >= 300


@pytest.mark.parametrize("word", ["-v", "-V", "--version"])
def test_the_version_has_three_spellings(word: str) -> None:
    assert gsgen(word).out.startswith("gsgen ")
