import pytest

from support.reports.corpus_line import corpus_line

RULES = "tests/contract/rules"
BROKEN = f"{RULES}/test_corpus.py::test_a_broken_model_breaks_its_rule_and_no_other"
GOOD = f"{RULES}/test_corpus.py::test_a_good_model_breaks_nothing"
SILENT = f"{RULES}/test_rules_matter.py::test_the_corpus_notices_a_silent_rule"


@pytest.mark.parametrize(
    ("results", "line"),
    [
        ([], ""),
        ([("tests/contract/test_graph.py::test_a[b]", True)], ""),
        (
            [(f"{GOOD}[a]", True), (f"{BROKEN}[b]", True), (f"{BROKEN}[c]", True)],
            "3 models: 1 good, 2 broken; cross-talk 0",
        ),
        (
            [(f"{GOOD}[a]", False), (f"{BROKEN}[b]", False), (f"{SILENT}[GV001]", True)],
            "2 models: 1 good, 1 broken; cross-talk 2; 1 rules silenced one by one, 1 noticed; "
            "matrix 2 × 1 = 2",
        ),
        (
            [(f"{SILENT}[GV001]", False), (f"{SILENT}[GV002]", True)],
            "2 rules silenced one by one, 1 noticed",
        ),
    ],
)
def test_the_line_counts_models_rules_and_slips(results, line):
    assert corpus_line(results) == line
