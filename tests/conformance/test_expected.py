"""Expected failures: read from a file, strict both ways, in pytest and on the command line."""

from pathlib import Path

import pytest

from conformance.pytest_runs import run_pytest, write
from gsgen.conformance.expected import ExpectedFailure, read_expected, unmatched_entries
from gsgen.contract.errors import ConfigInvalid, UnknownName
from gsgen.contract.rules.catalogue import installed_rules
from support.commands import gsgen_here

EXPECTED_FAILURES_TOML = (
    '[[xfail]]\nrule = "opacity-range"\nmodel = "opacity*.onnx"\nreason = "until 2.0"\n'
)


def read(tmp_path: Path, text: str) -> tuple[ExpectedFailure, ...]:
    file = tmp_path / "known.toml"
    file.write_text(text)
    return read_expected(file, installed_rules())


def test_a_file_names_rules_by_id_or_name(tmp_path: Path) -> None:
    more = '[[xfail]]\nrule = "gv001"\nreason = "known"\n'
    first, second = read(tmp_path, EXPECTED_FAILURES_TOML + more)
    assert (first.rule, first.model, first.reason) == ("GV003", "opacity*.onnx", "until 2.0")
    assert (second.rule, second.model) == ("GV001", "")
    assert first.matches("GV003", Path("a/opacity_is_logits.onnx"))
    assert not first.matches("GV003", Path("a/drift.onnx"))
    assert not first.matches("GV001", Path("opacity.onnx"))
    assert second.matches("GV001", Path("any.onnx"))


def test_an_empty_file_expects_nothing(tmp_path: Path) -> None:
    assert read(tmp_path, "") == ()


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("[[xfail", ConfigInvalid, "is not TOML"),
        ("xfail = 3", ConfigInvalid, "3, expected tables [[xfail]]"),
        ('[[xfails]]\nrule = "GV003"', UnknownName, "unknown key 'xfails'"),
        (
            '[[xfail]]\nrule = "GV003"',
            ConfigInvalid,
            "xfail 1: the table [[xfail]] lacks the key 'reason'",
        ),
        (
            '[[xfail]]\nreason = "x"',
            ConfigInvalid,
            "xfail 1: the table [[xfail]] lacks the key 'rule'",
        ),
        ('[[xfail]]\nrule = "GV003"\nreason = " "', ConfigInvalid, "key 'reason' is ' '"),
        (
            '[[xfail]]\nrule = 3\nreason = "x"',
            ConfigInvalid,
            "key 'rule' is 3, expected a non-empty string",
        ),
        ('[[xfail]]\nrule = "GV999"\nreason = "x"', UnknownName, "unknown rule 'GV999'"),
        ('[[xfail]]\nrule = "GV003"\nmodle = "x"', UnknownName, "Did you mean 'model'?"),
    ],
)
def test_invalid_expectation_file_is_refused(
    tmp_path: Path, text: str, error: type[Exception], words: str
) -> None:
    with pytest.raises(error) as caught:
        read(tmp_path, text)
    assert words in str(caught.value)
    assert "known.toml" in str(caught.value)


def test_unmatched_entries_are_reported() -> None:
    known = ExpectedFailure("GV003", "?", "drift.onnx")
    other_rule, other_model = (ExpectedFailure("TV101", "?"), ExpectedFailure("GV003", "?", "x"))
    tested = {Path("out/drift.onnx"): ["GV001", "GV003"]}
    assert unmatched_entries([known, other_rule, other_model], tested) == [other_rule, other_model]


def test_pytest_fails_on_fulfilled_or_unmatched_entries(folder: Path) -> None:
    write(folder, "drift", "opacity_is_logits")
    models = ("--gsgen=drift.onnx", "--gsgen=opacity_is_logits.onnx", "-k", "GV003 or xfail")
    (folder / "known.toml").write_text(EXPECTED_FAILURES_TOML)
    completed = run_pytest(folder, *models, "--gsgen-level=values", "--gsgen-xfails=known.toml")
    assert completed.code == 0, completed.out
    assert completed.names("xfailed") == ["opacity_is_logits.onnx.basic::GV003-opacity-range"]
    assert "until 2.0" in completed.out
    stale = EXPECTED_FAILURES_TOML.replace("opacity*", "d*") + EXPECTED_FAILURES_TOML.replace(
        "opacity*", "none"
    )
    (folder / "known.toml").write_text(stale)
    completed = run_pytest(folder, *models, "--gsgen-level=values", "--gsgen-xfails=known.toml")
    assert completed.code == 1
    assert sorted(completed.names("failure")) == [
        "drift.onnx.basic::GV003-opacity-range",
        "opacity_is_logits.onnx.basic::GV003-opacity-range",
    ]
    assert "holds, but is expected to fail: remove the entry" in completed.out
    assert len(completed.names("error")) == 1
    assert "GV003 of none.onnx (until 2.0)" in completed.out


def test_command_fails_on_fulfilled_or_unmatched_entries(folder: Path) -> None:
    (model,) = write(folder, "opacity_is_logits")
    known = folder / "known.toml"
    known.write_text(EXPECTED_FAILURES_TOML)
    completed = gsgen_here("conformance", model, "--xfails", known, "--level", "values")
    assert completed.code == 0, completed.out + completed.err
    assert "1 expected" in completed.out
    assert "until 2.0" in completed.out
    known.write_text(EXPECTED_FAILURES_TOML.replace("opacity-range", "rows-finite"))
    completed = gsgen_here("conformance", model, "--xfails", known, "--level", "values")
    assert completed.code == 1
    assert "2 failed" in completed.out
    known.write_text(EXPECTED_FAILURES_TOML.replace("opacity*", "none"))
    completed = gsgen_here("conformance", model, "--xfails", known, "--level", "static")
    assert completed.code == 2
    assert "matches no rule of any tested model" in completed.err
