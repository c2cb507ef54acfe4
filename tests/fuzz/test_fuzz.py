"""A slice of what ``make fuzz`` does, and proof that the fuzzer sees what it looks for."""

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from fuzz import __main__ as command
from fuzz import judging
from fuzz.case import draw
from fuzz.corpus import bases
from fuzz.pool import Pool
from gsgen.conformance.fixtures import fixtures
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.rule import Registry
from support.reports.rules import crashing, made_up

TESTS = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return bases(tmp_path_factory.mktemp("bases"))


def write(case, folder):
    path = (case.base.folder or folder) / f"case_{case.index}.onnx"
    path.write_bytes(case.content)
    return path


pytestmark = pytest.mark.slow


def registry_with(*rules):
    retained = (
        rule for rule in installed_rules().rules.values() if rule.id not in {r.id for r in rules}
    )
    return Registry.from_rules([*retained, *rules])


def test_a_case_is_decided_by_its_numbers_alone(corpus):
    for index in range(30):
        assert draw(7, index, corpus) == draw(7, index, corpus)
    assert draw(7, 0, corpus).content != draw(8, 0, corpus).content


def test_mutants_differ_from_their_models_and_from_each_other(corpus):
    cases = [draw(0, index, corpus) for index in range(250)]
    changed = [case for case in cases if case.content != case.base.content]
    assert len(changed) > 0.9 * len(cases)
    assert len({case.content for case in changed}) > 0.98 * len(changed)
    kinds = {name for case in cases for name in case.mutations}
    assert len(kinds) > 30
    assert len({case.base.name for case in cases}) > 100


def test_the_validator_stands_the_first_mutants_and_a_run_goes_on(tmp_path):
    """In a process of its own: peaks of memory are those of all children that a process had."""
    words = [sys.executable, "-m", "fuzz", "--count", "25", "--jobs", "1", "--folder", tmp_path]
    first = subprocess.run(words, cwd=TESTS, capture_output=True, text=True, timeout=300)
    assert first.returncode == 0, first.stderr
    expected_message = first.stdout
    assert expected_message.startswith("fuzz, seed 0: 25 of 25 mutants (")
    assert expected_message.endswith("; 0 failed\n")
    log = tmp_path / "seed-0" / "cases.jsonl"
    message = [json.loads(line) for line in log.read_text().splitlines()]
    assert [entry["case"] for entry in message] == list(range(25))
    assert {"invalid", "unreadable"} <= {entry["verdict"] for entry in message}
    assert any(entry["ran"] for entry in message)
    again = subprocess.run(words, cwd=TESTS, capture_output=True, text=True, timeout=300)
    assert (again.returncode, again.stdout) == (0, expected_message)  # nothing is left to judge
    assert log.read_text().count("\n") == 25


def test_failing_case_is_saved_with_its_repro_command(corpus, tmp_path):
    neighbour_index = next(k for k in range(500) if draw(0, k, corpus).base.folder is not None)
    for index in (0, neighbour_index):
        command._save_failure(0, {"case": index, "failures": ["it crashed"]}, tmp_path)
        kept_path = tmp_path / "failures" / str(index)
        case = draw(0, index, corpus)
        (model,) = kept_path.rglob("model.onnx")
        assert model.read_bytes() == case.content
        again = (kept_path / "reproduce.sh").read_text()
        assert f"gsgen validate {model} --level {case.level.word}" in again
        assert f"python -m fuzz --seed 0 --only {index}\n" in again
        assert json.loads((kept_path / "case.json").read_text())["failures"] == ["it crashed"]
        assert len(list(kept_path.iterdir())) == 3


@pytest.fixture
def good(corpus, tmp_path):
    """A model that runs, as a case without mutations."""
    name = next(fixture.name for fixture in fixtures() if not fixture.rule)
    base = next(entry for entry in corpus if entry.name == name)
    case = replace(draw(0, 0, corpus), base=base, content=base.content, target="core")
    return replace(case, command=False, level=Level.VALUES)


def test_a_good_model_fails_nothing_and_runs(good, tmp_path):
    verdict = judging.judge(good, write(good, tmp_path))
    assert verdict == judging.Verdict("conforms", True, ())


@pytest.mark.parametrize("scope", ["model", "rows"])
def test_a_rule_that_crashes_is_seen(good, tmp_path, scope):
    registry = registry_with(made_up("acme/AC001", crashing, over=scope))
    verdict = judging.judge(good, write(good, tmp_path), registry)
    (failure,) = verdict.failures
    assert verdict.word == "internal-error"
    assert failure.startswith("acme/AC001 crashed: ")
    assert "ZeroDivisionError: no luck" in failure


def test_an_error_that_escapes_is_seen(good, tmp_path, monkeypatch):
    def raising(*_, **__):
        raise KeyError("no such thing")

    monkeypatch.setattr(judging, "validate", raising)
    verdict = judging.judge(good, write(good, tmp_path))
    assert verdict.word == "raised"
    assert "KeyError: 'no such thing'" in verdict.failures[0]


def test_a_child_that_dies_unseen_is_seen(good, tmp_path, monkeypatch):
    product = judging.sandbox._run_child

    def crashed(*words):
        return product(*words)._replace(status=-11)  # as if it had read a wrong address

    monkeypatch.setattr(judging.sandbox, "_run_child", crashed)
    path = write(good, tmp_path)
    message = judging.judge(good, path)
    assert (message.word, message.failures) == ("invalid", ())  # GV025 says so
    blind_registry = registry_with(made_up("GV025", over="execution"))
    verdict = judging.judge(good, path, blind_registry)
    assert any(
        "ended with [-11], and the report does not" in failure for failure in verdict.failures
    )


def test_hung_or_dead_worker_is_replaced_and_reported():
    pool = Pool(seed=0, jobs=2, worker="fuzz.misbehaving_worker", limit=0.5)
    message = {entry["case"]: entry for entry in pool.judged(range(5), time.monotonic() + 60)}
    assert sorted(message) == [0, 1, 2, 3, 4]
    assert message[1]["failures"] == ["still busy after 0.5 s"]
    assert message[2]["failures"] == ["the validator's process ended with -6: no luck"]
    assert [message[index]["failures"] for index in (0, 3, 4)] == [[], [], []]
