import pytest

from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation import gates
from gsgen.contract.validation.engine import validate_with
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings

# Names of single rules, not of groups.
SINGLE_RULES = ("AT_MOMENTS", "MODEL_RUNS")
GATES = {name: getattr(gates, name) for name in gates.__all__ if name not in SINGLE_RULES}


@pytest.mark.parametrize("name", GATES)
def test_a_gate_holds_known_rules_once_each(name):
    rules = installed_rules().rules
    assert set(GATES[name]) <= set(rules)
    assert len(set(GATES[name])) == len(GATES[name])


@pytest.mark.parametrize("name", GATES)
def test_a_rule_that_needs_a_whole_gate_takes_it_from_there(name):
    needs = [rule.needs for rule in installed_rules().rules.values()]
    assert any(set(GATES[name]) <= set(ids) for ids in needs)


def test_without_the_rule_that_the_model_runs_no_model_is_run(tmp_path):
    from gsgen.conformance.fixtures import find

    path = find("still_sh0").write(tmp_path)
    static = (rule for rule in installed_rules().rules.values() if not rule.needs)
    registry = Registry.from_rules(rule for rule in static if rule.level.word == "static")
    report = validate_with(registry, path, Settings())
    (reason,) = {level.reason for level in report.levels if level.level.word == "values"}
    assert reason == f"the model was not run because no rule {gates.MODEL_RUNS} is installed"
