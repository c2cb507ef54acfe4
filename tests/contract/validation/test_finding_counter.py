import numpy as np
import pytest

from gsgen.contract.validation.finding import Example, Location, Violation
from gsgen.contract.validation.finding_counter import FindingCounter

WHERE = Location("output g", "opacity")


def rows(bad, values=None, **options):
    bad = np.asarray(bad, bool)
    values = np.arange(len(bad), dtype=np.float64) if values is None else np.asarray(values)
    return Violation.rows(WHERE, bad, values, "less", judged=len(bad), **options)


def tally(*breaches, probe="", starts=None):
    made = FindingCounter(WHERE, "less", breaches[0].actual if breaches else "")
    for breach, start in zip(breaches, starts or [0] * len(breaches), strict=True):
        made.add(breach, probe, start)
    return made


def test_nothing_bad_does_not_fail():
    made = tally(rows([False] * 3))
    assert (made.count, made.total, made.fails) == (0, 3, False)


def test_a_tally_without_breaches_does_not_fail():
    assert not tally().fails


def test_rows_are_counted_over_all_chunks_and_numbered_through():
    made = tally(rows([0, 1, 0]), rows([1, 1, 0]), starts=[0, 3])
    assert (made.count, made.total) == (3, 6)
    assert made.examples == [Example("1", 1), Example("0", 3), Example("1", 4)]


def test_only_the_first_five_are_shown_but_all_are_counted():
    made = tally(rows([1] * 4), rows([1] * 4), starts=[0, 4])
    assert [example.row for example in made.examples] == [0, 1, 2, 3, 4]
    assert made.count == 8


def test_the_worst_row_is_the_largest_badness_among_the_bad_ones():
    first = rows([1, 0, 1], magnitude=np.array([1.0, 9.0, 2.0]))
    second = rows([0, 1, 0], magnitude=np.array([9.0, 1.5, 9.0]))
    assert tally(first, second, starts=[0, 3]).worst == Example("2", 2)
    assert tally(second, first, starts=[0, 3]).worst == Example("2", 5)


def test_what_is_not_a_number_is_the_worst():
    made = tally(rows([1, 1, 0], magnitude=np.array([1.0, np.nan, np.nan])))
    assert made.worst == Example("1", 1)


def test_there_is_no_worst_where_the_rule_cannot_say():
    assert tally(rows([1])).worst is None


@pytest.mark.parametrize(("bad", "fails"), [(89, False), (90, False), (91, True)])
def test_a_share_fails_only_above_it(bad, fails):
    made = tally(rows([1] * bad + [0] * (100 - bad), min_fraction=0.9))
    assert made.fails is fails


def test_the_share_is_that_of_all_chunks_together():
    chunks = [rows([1] * 10, min_fraction=0.9), rows([0] * 10, min_fraction=0.9)]
    assert not tally(*chunks, starts=[0, 10]).fails


@pytest.mark.parametrize(
    ("values", "shown"),
    [
        ([0.1234567890], "0.123457"),
        ([[1.0, np.nan, -np.inf]], "(1, nan, -inf)"),
        ([np.arange(48.0)], "(0, 1, 2, 3, 4, 5, 6, 7, 8, 9)"),
        (np.array([1.5], np.float16), "1.5"),
    ],
)
def test_a_row_is_shown_in_six_digits_and_ten_values_at_most(values, shown):
    assert tally(rows([1], values)).examples == [Example(shown, 0)]


def test_a_message_about_rows_says_how_many_the_first_and_the_worst():
    made = tally(rows([0, 1, 1, 0], magnitude=np.array([0.0, 1, 2, 0])), probe="time=1")
    assert made.message() == (
        "2 of 4 rows (50 %), first row 1 (time=1): 1, worst row 2 (time=1): 2; wanted less"
    )


def test_the_worst_is_not_repeated_where_it_is_the_first():
    made = tally(rows([1, 1], magnitude=np.array([2.0, 1.0])))
    assert made.message() == "2 of 2 rows (100 %), first row 0: 0; wanted less"


@pytest.mark.parametrize(
    ("times", "probe", "message"),
    [
        (1, "", "9 rows; wanted 10 rows"),
        (1, "time=0", "9 rows (time=0); wanted 10 rows"),
        (3, "time=0", "9 rows (time=0) (and 2 more like it); wanted 10 rows"),
    ],
)
def test_a_message_about_things_says_what_was_seen(times, probe, message):
    breach = Violation.at("output g", "9 rows", "10 rows")
    made = FindingCounter(breach.where, breach.expected, breach.actual)
    for _ in range(times):
        made.add(breach, probe)
    assert made.message() == message
    assert made.total == made.count == times


def test_a_million_bad_rows_take_no_more_room_than_five():
    bad = np.ones(1_000_000, bool)
    values = np.full((1_000_000, 10), np.nan, np.float32)
    made = tally(rows(bad, values, magnitude=np.arange(1e6)))
    assert made.count == 1_000_000
    assert len(made.examples) == 5
    assert made.worst == Example("(" + ", ".join(["nan"] * 10) + ")", 999_999)
    assert len(made.message()) < 300
