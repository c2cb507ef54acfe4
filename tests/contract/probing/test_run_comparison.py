import numpy as np
import pytest

from gsgen.contract.probing import differences
from gsgen.contract.probing.differences import largest_difference
from gsgen.contract.probing.probe_plan import Plan
from gsgen.contract.probing.probes import Probe
from gsgen.contract.probing.run_comparison import Comparison, ProbeRuns, read_behaviour
from gsgen.contract.probing.sandbox import Execution, Run, Sample


def compared(*outputs, samples=None, variants=None, revisited_pair=None):
    """What is seen when the runs, from first to last, gave ``outputs``."""
    probes = tuple(Probe(label=f"probe {index}", inputs={}) for index in range(len(outputs)))
    numbers = samples or range(len(outputs))
    runs = tuple(
        Run(probe=index, sample=sample, seconds=0.1) for index, sample in enumerate(numbers)
    )
    retained = tuple(Sample(index=index, outputs=output) for index, output in enumerate(outputs))
    plan = Plan(
        probes=probes,
        values=1,
        repeated=(0, 1),
        revisited_pair=revisited_pair,
        variants=variants or {},
    )
    return read_behaviour(
        ProbeRuns(
            None, Execution(runs=runs, samples=retained, fault=None, seconds=0.0, version=""), plan
        )
    )


def array(*values, dtype=np.float32):
    return {"y": np.array(values, dtype)}


def test_runs_that_share_a_sample_do_not_differ():
    comparison = compared(array(1), array(2), samples=[0, 0])
    assert comparison.repeated == Comparison("probe 0", "probe 1", {})
    assert comparison.revisited_pair is None
    assert comparison.comparisons_by_role == {}


@pytest.mark.parametrize(
    ("first", "second", "changed"),
    [
        (array(1, 2), array(1, 2), {}),
        (array(1, 2), array(1, 2.5), {"y": 0.5}),
        (array(0.0), array(-0.0), {"y": 0.0}),
        (array(np.nan), array(np.nan), {}),
        (array(np.nan, 1), array(0, 1), {"y": np.inf}),
        (array(np.inf, 1), array(-np.inf, 1), {"y": np.inf}),
        (array(np.inf, 1), array(np.inf, 3), {"y": 2.0}),
        (array(np.nan, 1), array(np.nan, 3), {"y": 2.0}),
        (array(1, 2), array(1), {"y": np.inf}),
        (array(250, dtype=np.uint8), array(5, dtype=np.uint8), {"y": 245.0}),
        (array(True, dtype=bool), array(False, dtype=bool), {"y": 1.0}),
        (array(), array(), {}),
    ],
)
def test_the_largest_difference_of_each_output_that_differs_is_kept(first, second, changed):
    assert compared(first, second).repeated.changed == changed


def test_outputs_are_compared_one_by_one():
    first = {"a": np.zeros(2), "b": np.zeros(2), "c": np.zeros(2)}
    second = {"a": np.zeros(2), "b": np.ones(2), "c": np.full(2, 3.0)}
    assert compared(first, second).repeated.changed == {"b": 1.0, "c": 3.0}


def test_every_role_is_compared_with_its_base():
    comparison = compared(
        *(array(value) for value in (1, 1, 2, 4)),
        variants={"time": (0, (2, 3)), "view": (1, (2,))},
        revisited_pair=(0, 3),
    )
    assert comparison.revisited_pair == Comparison("probe 0", "probe 3", {"y": 3.0})
    assert [entry.changed for entry in comparison.comparisons_by_role["time"]] == [
        {"y": 1.0},
        {"y": 3.0},
    ]
    assert [(entry.first, entry.second) for entry in comparison.comparisons_by_role["view"]] == [
        ("probe 1", "probe 2")
    ]


def test_reading_an_unfinished_extra_run_notes_it():
    probes = tuple(Probe(label=f"probe {index}", inputs={}, extra=index > 1) for index in range(5))
    samples, errors = (0, 0, 0, -1, -1), ("", "", "", "", "bad")
    runs = tuple(
        Run(
            probe=number,
            sample=sample,
            seconds=0.1,
            error=error,
            missing_resource="memory" if sample < 0 and not error else "",
        )
        for number, (sample, error) in enumerate(zip(samples, errors, strict=True))
    )
    trials = {"edges": (2, 3), "outside": (4,)}
    plan = Plan(probes=probes, values=1, repeated=(0, 1), trials=trials)
    execution = Execution(
        runs=runs, samples=(Sample(index=0, outputs=array(1)),), fault=None, seconds=0.0, version=""
    )
    behaviour = read_behaviour(ProbeRuns(None, execution, plan))
    first, second = behaviour.without_unfinished(), behaviour.without_unfinished()
    assert [edge_run.probe.label for edge_run in first.trial_runs("edges")] == ["probe 2"]
    assert first.unfinished_probes == [("probe 3", "memory")]
    assert [edge_run.error for edge_run in second.trial_runs("outside")] == ["bad"]  # it did run
    assert second.unfinished_probes == behaviour.unfinished_probes == []


@pytest.mark.parametrize("block", [5, 1 << 20])
@pytest.mark.parametrize(
    ("first", "second", "largest"),
    [
        ([1.0, 2.0, np.nan, np.inf], [1.0, 2.5, np.nan, np.inf], 0.5),
        ([1.0, np.nan, 3.0, 4.0], [1.0, 2.0, 3.0, 4.0], np.inf),
        ([1.0, np.inf, 3.0, 4.0], [1.0, -np.inf, 3.0, 4.0], np.inf),
        ([0.0, 0.0, 0.0, 0.0], [-0.0, 0.0, 0.0, 0.0], 0.0),
    ],
)
def test_the_largest_difference_of_two_arrays(first, second, largest, block, monkeypatch):
    monkeypatch.setattr(differences, "_BLOCK_ELEMENTS", block)
    a, b = (np.array([0.0] * 9 + values).reshape(-1, 1) for values in (first, second))
    assert largest_difference(a, b) == largest
    assert largest_difference(a[::-1], b[::-1]) == largest
    assert largest_difference(a[:0], b[:0]) == 0
    assert largest_difference(a, b[1:]) == np.inf
