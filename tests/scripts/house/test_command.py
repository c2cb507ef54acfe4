"""The command: exit codes, selection, and the table of exceptions."""

import pytest
from check_house import EXCEPTIONS, main
from house.checks import CHECKS
from house.exceptions import ExceptionsInvalid, read_exceptions

NAMES = {check.name for check in CHECKS}


@pytest.fixture
def checkout(tmp_path):
    for folder in ("sdk", "runtime"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.py").write_text("made = 1\n")
    (tmp_path / "exceptions.toml").write_text("")
    return tmp_path


def run(checkout, *arguments):
    table = str(checkout / "exceptions.toml")
    return main(["--root", str(checkout), "--exceptions", table, *arguments])


def allow(checkout, path, **entries):
    lines = "".join(f"{key} = {value!r}\n" for key, value in entries.items())
    text = f'[[exception]]\ncheck = "placeholders"\npath = "{path}"\n{lines}'
    with (checkout / "exceptions.toml").open("a") as table:
        table.write(text)


def test_a_broken_bar_is_printed_with_every_violation(checkout, capsys):
    assert run(checkout) == 1
    output = capsys.readouterr().out
    assert "FAIL  placeholders" in output
    assert "placeholders: sdk/a.py:1: variable 'made' of the module; expected" in output
    assert all(check.name in output for check in CHECKS)


def test_one_check_alone(checkout, capsys):
    assert run(checkout, "--only", "folders", "cycles") == 0
    assert [line.split()[1] for line in capsys.readouterr().out.splitlines()] == [
        "folders",
        "cycles",
    ]


def test_paths_select_what_is_reported(checkout, capsys):
    (checkout / "runtime" / "a.py").write_text("entry = 1\n")
    assert run(checkout, str(checkout / "runtime"), "--only", "placeholders") == 0
    assert run(checkout, str(checkout / "sdk" / "a.py"), "--only", "placeholders") == 1
    assert "runtime" not in capsys.readouterr().out


def test_an_exception_permits_its_violation_alone(checkout, capsys):
    allow(checkout, "sdk/*", reason="a participle that this folder's paper uses")
    assert run(checkout, "--only", "placeholders", "--list") == 1
    output = capsys.readouterr().out
    assert "sdk/a.py:1" not in output
    assert "runtime/a.py:1" in output
    assert "excepted: placeholders: sdk/* *: a participle" in output
    allow(checkout, "runtime/a.py", subjects=["made"], reason="a participle of the field")
    assert run(checkout) == 0


def test_an_exception_that_permits_nothing_fails(checkout, capsys):
    allow(checkout, "*", reason="allows both files for this test")
    allow(checkout, "sdk/*", subjects=["found"], reason="the name is gone from this folder")
    assert run(checkout) == 1
    assert "exception permits nothing: placeholders: sdk/* found" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({}, "missing keys ['reason']"),
        ({"reason": "short"}, "explains nothing"),
        ({"reason": "long enough to explain", "line": 3}, "unknown keys ['line']"),
        ({"reason": "long enough to explain", "subjects": "made"}, "a list of names"),
    ],
)
def test_an_entry_without_a_reason_is_refused(checkout, capsys, entries, message):
    allow(checkout, "*", **entries)
    assert run(checkout) == 2
    assert message in capsys.readouterr().err


def test_an_entry_for_an_unknown_check_is_refused(tmp_path):
    table = tmp_path / "table.toml"
    table.write_text('[[exception]]\ncheck = "nosuch"\npath = "*"\nreason = "long enough to pass"')
    with pytest.raises(ExceptionsInvalid, match=r"entry 1: check 'nosuch'; expected one of any, "):
        read_exceptions(table, NAMES)


def test_a_file_that_does_not_parse_is_an_error(checkout, capsys):
    (checkout / "sdk" / "a.py").write_text("x = 1\ndef (:\n")
    assert run(checkout) == 2
    assert "sdk/a.py:2" in capsys.readouterr().err


def test_a_path_outside_of_the_checkout_is_refused(checkout, capsys):
    with pytest.raises(SystemExit) as raised:
        run(checkout, str(checkout.parent), "--only", "folders")
    assert raised.value.code == 2
    assert "expected a file or folder in" in capsys.readouterr().err


def test_the_table_of_this_repository_is_valid():
    assert all(len(entry.reason) > 15 for entry in read_exceptions(EXCEPTIONS, NAMES))
