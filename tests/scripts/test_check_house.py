"""Each house rule fails on code that breaks it, and passes beside it."""

import sys
from pathlib import Path

import pytest

from support.commands import ROOT

sys.path.insert(0, str(ROOT / "scripts"))
import check_house

FIELDS = "".join(f"    {name}: int\n" for name in "abcde")
CLASS = "@dataclass({})\nclass Point:\n" + FIELDS
SHADER = "fn f() {\n%s}\n"

CASES = {
    "folders": (
        {f"sdk/room/m{n}.py": "" for n in range(16)},
        {f"sdk/room/m{n}.py": "" for n in range(15)} | {"sdk/room/__init__.py": ""},
    ),
    "lengths": (
        {"sdk/a.py": 'def f():\n    """Do it."""\n' + "    pass\n" * 81},
        {"sdk/a.py": 'def f():\n    """Do it."""\n' + "    pass\n" * 80},
    ),
    "placeholders": (
        {"sdk/a.py": "def f(count):\n    made_2 = made = _kept2 = count\n"},
        {"sdk/a.py": "def f(count):\n    result = made_up = count\n"},
    ),
    "fields": (
        {"sdk/a.py": CLASS.format("frozen=True")},
        {"sdk/a.py": CLASS.format("kw_only=True"), "sdk/b.py": "class Bag:\n" + FIELDS},
    ),
    "constants": (
        {"sdk/a.py": "SH_C0 = 0.2821\n", "runtime/b.py": "_SH_C0: Final = 0.2821\n"},
        {"sdk/a.py": "SHARE = 0.001\nLOW = 0.2821", "runtime/b.py": "SHARE = 0.001\nHIGH = 0.2821"},
    ),
    "shaders": (
        {"runtime/a.wgsl": SHADER % "//!include circle\n"},
        {"runtime/a.wgsl": "//!include circle\n" + SHADER % "  // {\n"},
    ),
    "phrases": (
        {"docs/a.md": "The list is none.\n"},
        {"docs/a.md": "The `list is none`.\n\n```text\nwhat is\n```\n\nWhat is a list?\n"},
    ),
    "imports": (
        {"docs/a.md": "```python\nfrom gsgen.runtime.gpu import device\n```\n"},
        {"docs/a.md": "```python\nfrom gsgen.sdk import export\n```\n\nfrom gsgen.runtime.gpu\n"},
    ),
}


def findings(check: str, root: Path, files: dict[str, str]) -> list[str]:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    find = check_house.CHECKS[check][0]
    return find(check_house.read_sources(root))[0]


def test_every_check_has_a_case() -> None:
    assert list(CASES) == list(check_house.CHECKS)


@pytest.mark.parametrize("check", CASES)
def test_code_that_breaks_a_rule_is_found(check: str, tmp_path: Path) -> None:
    broken, right = CASES[check]
    assert findings(check, tmp_path / "broken", broken)
    assert findings(check, tmp_path / "right", right) == []


@pytest.mark.parametrize(
    "text",
    [
        "“there is\nno”, whatever it is",
        "as told",
        "nobody reads it",
        "It is computed anew.",
        "It lies beside the file.",
        "Say whether it is finite.",
        "A mended file is judged.",
    ],
)
def test_a_phrase_is_found_over_line_ends(text: str, tmp_path: Path) -> None:
    assert findings("phrases", tmp_path, {"sdk/a.py": f'"""{text}"""\n'})


def test_a_file_of_501_lines_is_found(tmp_path: Path) -> None:
    assert findings("lengths", tmp_path, {"sdk/a.py": "\n" * 500 + "x = 1\n"})
    assert not findings("lengths", tmp_path, {"sdk/a.py": "\n" * 499 + "x = 1\n"})


def test_failed_checks_give_exit_code_1_and_list_their_violations(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sdk").mkdir()
    (tmp_path / "sdk/a.py").write_text("made = 1\n", "utf-8")
    (tmp_path / "sdk/b.py").write_text("entry = 1\n", "utf-8")
    sources = check_house.read_sources(tmp_path)
    assert check_house.run_checks(sources) == 1
    printed = capsys.readouterr().out
    assert "placeholders: sdk/a.py:1: made" in printed
    assert "FAIL  placeholders     50.00 in 100; bar 1" in printed
    assert check_house.run_checks(sources, ["sdk/b.py"]) == 0


def test_exceptions_name_paths_that_exist() -> None:
    for paths in check_house.EXCEPTIONS.values():
        assert all((ROOT / path).exists() for path in paths)
