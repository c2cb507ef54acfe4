import pickle

import pytest

from gsgen.contract.errors import ExitCode, GsgenError
from gsgen.formats import FileTruncated, FileUnwritable, FormatError
from gsgen.formats.shared import errors


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({}, "3 rows"),
        ({"path": "a.ply"}, "a.ply: 3 rows"),
        ({"where": "property x", "expected": "4"}, "property x: 3 rows\nexpected 4"),
        (
            {"path": "a.ply", "where": "row 1", "expected": "4", "hint": "try again"},
            "a.ply: row 1: 3 rows\nexpected 4\ntry again",
        ),
    ],
)
def test_error_text_contains_only_known_fields(fields, text):
    assert str(FormatError("3 rows", **fields)) == text


def test_an_error_survives_being_sent_to_another_process():
    error = FileTruncated("3 rows", where="row 1", expected="4", hint="m", path="a.ply")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is FileTruncated
    assert str(copy) == str(error)


def test_every_public_error_is_a_format_error():
    for name in errors.__all__:
        assert issubclass(getattr(errors, name), FormatError)


def test_format_errors_are_gsgen_errors_with_the_exit_code_of_unreadable_files():
    assert issubclass(FormatError, GsgenError)
    assert FileTruncated("3 rows").exit_code == ExitCode.UNREADABLE == 4
    assert FileUnwritable("is a pipe").exit_code == ExitCode.USAGE == 2


def test_names_from_a_file_are_cut_short_and_quoted():
    assert errors.quoted("a" * 100) == repr("a" * 59 + "…")
    assert errors.join_names(["x", "y\x1b[2J"]) == r"x, 'y\x1b[2J'"
    assert errors.join_names(list("abcd"), limit=2) == "a, b, and 2 more"
    assert errors.join_names([]) == "nothing"
