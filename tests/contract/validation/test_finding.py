from dataclasses import replace

import pytest

from gsgen.contract.errors import GsgenError, UnknownName
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Example, Finding, Location


def test_severities_and_levels_are_ordered_and_read_in_any_case():
    assert Severity.words() == ("info", "warning", "error")
    assert Level.words() == ("static", "values", "behaviour", "live", "render")
    assert Severity.parse("Warning") == Severity.WARNING > Severity.INFO
    assert Level.parse("LIVE") == Level.LIVE > Level.BEHAVIOUR


@pytest.mark.parametrize(
    ("kind", "word", "text"),
    [
        (Severity, "mild", "x: unknown severity 'mild'\n  Known: error, info, warning."),
        (Severity, "fatal", "x: unknown severity 'fatal'\n  Did you mean 'error'?"),
        (Severity, "warn", "x: unknown severity 'warn'\n  Did you mean 'warning'?"),
        (Level, "behavior", "x: unknown level 'behavior'\n  Did you mean 'behaviour'?"),
    ],
)
def test_an_unknown_word_names_the_nearest(kind, word, text):
    with pytest.raises(UnknownName) as caught:
        kind.parse(word, "x")
    assert str(caught.value) == text


@pytest.mark.parametrize(
    ("example", "text"),
    [
        (Example("nan"), "nan"),
        (Example("nan", 3), "row 3: nan"),
        (Example("nan", 3, "time=1"), "row 3 (time=1): nan"),
        (Example("nan", None, "time=1"), "nan"),
    ],
)
def test_an_example_says_its_row_and_probe(example, text):
    assert str(example) == text


def test_location_includes_its_field():
    assert str(Location("output g")) == "output g"
    assert str(Location("output g", "opacity")) == "output g, opacity"


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({}, "9 rows"),
        ({"where": "output g"}, "output g: 9 rows"),
        ({"hint": "Try again."}, "9 rows\n  Try again."),
        ({"where": "output g", "hint": "Try again."}, "output g: 9 rows\n  Try again."),
    ],
)
def test_error_states_location_message_and_hint(fields, text):
    assert str(GsgenError("9 rows", **fields)) == text


FINDING = Finding(
    rule="GV003",
    slug="opacity-range",
    severity=Severity.ERROR,
    where=Location("output g", "opacity"),
    message="2 of 4 rows",
    hint="Repair it.",
    count=2,
    total=4,
    examples=(Example("1.5", 3, "time=0"),),
)


@pytest.mark.parametrize(
    "change",
    [
        {"count": 3, "total": 9, "message": "3 of 9 rows"},
        {"examples": (Example("nan", 1, "time=1"), Example("2", 2))},
        {"severity": Severity.INFO, "waived": True, "known": True, "hint": "Do."},
    ],
)
def test_a_fingerprint_does_not_change_with_numbers_and_settings(change):
    assert replace(FINDING, **change).fingerprint == FINDING.fingerprint == "b83b67613a63b931"


@pytest.mark.parametrize(
    "change",
    [
        {"rule": "GV004"},
        {"where": Location("output g")},
        {"where": Location("output h", "opacity")},
        {"examples": (Example("no rows"),)},
        {"certainty": "possible"},
    ],
)
def test_another_fault_has_another_fingerprint(change):
    assert replace(FINDING, **change).fingerprint != FINDING.fingerprint


def test_places_that_read_alike_have_their_own_fingerprints():
    joined = replace(FINDING, where=Location("output g, opacity"))
    assert str(joined.where) == str(FINDING.where)
    assert joined.fingerprint != FINDING.fingerprint


@pytest.mark.parametrize(("waived", "known"), [(True, False), (False, True)])
def test_waived_or_known_finding_does_not_count(waived, known):
    assert FINDING.counts
    assert not replace(FINDING, waived=waived, known=known).counts
