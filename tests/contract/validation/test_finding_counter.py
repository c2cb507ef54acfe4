import numpy as np
import pytest

from gsgen.contract.validation.finding import Example, Location, Violation
from gsgen.contract.validation.finding_counter import FindingCounter

LOCATION = Location("output g", "opacity")


def rows(invalid_rows, values=None, **options):
    invalid_rows = np.asarray(invalid_rows, bool)
    values = (
        np.arange(len(invalid_rows), dtype=np.float64) if values is None else np.asarray(values)
    )
    return Violation.rows(
        LOCATION, invalid_rows, values, "less", checked=len(invalid_rows), **options
    )


def tally(*breaches, probe="", starts=None):
    counter = FindingCounter(
        where=LOCATION, expected="less", actual=breaches[0].actual if breaches else ""
    )
    for breach, start in zip(breaches, starts or [0] * len(breaches), strict=True):
        counter.add(breach, probe, start)
    return counter


def test_counter_without_bad_rows_does_not_fail():
    counter = tally(rows([False] * 3))
    assert (counter.count, counter.total, counter.has_failing_finding) == (0, 3, False)


def test_counter_without_violations_does_not_fail():
    assert not tally().has_failing_finding


def test_rows_are_counted_over_all_chunks_and_numbered_through():
    counter = tally(rows([0, 1, 0]), rows([1, 1, 0]), starts=[0, 3])
    assert (counter.count, counter.total) == (3, 6)
    assert counter.examples == [Example("1", 1), Example("0", 3), Example("1", 4)]


def test_only_the_first_five_are_shown_but_all_are_counted():
    counter = tally(rows([1] * 4), rows([1] * 4), starts=[0, 4])
    assert [example.row for example in counter.examples] == [0, 1, 2, 3, 4]
    assert counter.count == 8


def test_worst_row_has_the_largest_magnitude_of_bad_rows():
    first = rows([1, 0, 1], magnitude=np.array([1.0, 9.0, 2.0]))
    second = rows([0, 1, 0], magnitude=np.array([9.0, 1.5, 9.0]))
    assert tally(first, second, starts=[0, 3]).worst == Example("2", 2)
    assert tally(second, first, starts=[0, 3]).worst == Example("2", 5)


def test_nan_magnitude_is_the_worst():
    counter = tally(rows([1, 1, 0], magnitude=np.array([1.0, np.nan, np.nan])))
    assert counter.worst == Example("1", 1)


def test_without_magnitudes_there_is_no_worst_row():
    assert tally(rows([1])).worst is None


@pytest.mark.parametrize(("invalid_rows", "is_failing"), [(89, False), (90, False), (91, True)])
def test_fraction_fails_only_above_its_minimum(invalid_rows, is_failing):
    counter = tally(rows([1] * invalid_rows + [0] * (100 - invalid_rows), min_fraction=0.9))
    assert counter.has_failing_finding is is_failing


def test_fraction_is_taken_over_all_chunks():
    chunks = [rows([1] * 10, min_fraction=0.9), rows([0] * 10, min_fraction=0.9)]
    assert not tally(*chunks, starts=[0, 10]).has_failing_finding


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ([0.1234567890], "0.123457"),
        ([[1.0, np.nan, -np.inf]], "(1, nan, -inf)"),
        ([np.arange(48.0)], "(0, 1, 2, 3, 4, 5, 6, 7, 8, 9)"),
        (np.array([1.5], np.float16), "1.5"),
    ],
)
def test_a_row_is_shown_in_six_digits_and_ten_values_at_most(values, text):
    assert tally(rows([1], values)).examples == [Example(text, 0)]


def test_a_message_about_rows_says_how_many_the_first_and_the_worst():
    counter = tally(rows([0, 1, 1, 0], magnitude=np.array([0.0, 1, 2, 0])), probe="time=1")
    assert counter.message() == (
        "2 of 4 rows (50 %), first row 1 (time=1): 1, worst row 2 (time=1): 2; expected less"
    )


def test_worst_row_is_omitted_if_it_is_the_first():
    counter = tally(rows([1, 1], magnitude=np.array([2.0, 1.0])))
    assert counter.message() == "2 of 2 rows (100 %), first row 0: 0; expected less"


@pytest.mark.parametrize(
    ("times", "probe", "message"),
    [
        (1, "", "9 rows; expected 10 rows"),
        (1, "time=0", "9 rows (time=0); expected 10 rows"),
        (3, "time=0", "9 rows (time=0) (and 2 more like it); expected 10 rows"),
    ],
)
def test_message_about_items_states_the_actual_value(times, probe, message):
    breach = Violation.at("output g", "9 rows", "10 rows")
    counter = FindingCounter(where=breach.where, expected=breach.expected, actual=breach.actual)
    for _ in range(times):
        counter.add(breach, probe)
    assert counter.message() == message
    assert counter.total == counter.count == times


def test_rows_are_hidden_by_number_if_one_probe_shows_them() -> None:
    """Sorted rows have another number in each run."""
    counter = tally(rows([0, 1, 0, 0], can_be_zeroed=True), probe="time=0")
    assert "rows[[1]] = 0" in counter.hint_of("Mend it.")
    counter.add(rows([0, 0, 0, 1], can_be_zeroed=True), "time=1")
    assert counter.hint_of("Mend it.") == "Mend it."


def test_a_million_bad_rows_take_no_more_room_than_five():
    invalid_rows = np.ones(1_000_000, bool)
    values = np.full((1_000_000, 10), np.nan, np.float32)
    counter = tally(rows(invalid_rows, values, magnitude=np.arange(1e6)))
    assert counter.count == 1_000_000
    assert len(counter.examples) == 5
    assert counter.worst == Example("(" + ", ".join(["nan"] * 10) + ")", 999_999)
    assert len(counter.message()) < 300


@pytest.mark.parametrize(
    "values",
    [
        [1e300, np.nextafter(1e300, np.inf)],  # no room for bins between them
        [-1.7e308, 1.7e308],  # their difference is infinite
        [5e-324, 1e-323],
        [2.0, 2.0],
        [-np.inf, np.nan, 1.0],
    ],
)
def test_any_finite_values_have_a_distribution(values):
    invalid_rows = [0] * (len(values) - 1) + [1]
    distribution = tally(rows(invalid_rows, values)).distribution()
    finite = np.isfinite(values)
    assert sum(distribution.valid) == finite[:-1].sum()
    assert sum(distribution.invalid) == finite[-1]
