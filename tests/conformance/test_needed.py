from gsgen.conformance.required_rules import needed_by
from gsgen.contract.rules.catalogue import installed_rules


def test_a_rule_comes_with_all_that_it_needs() -> None:
    registry = installed_rules()
    for rule in registry.rules.values():
        part = needed_by(rule, registry).rules
        assert rule.id in part
        assert all(need in part for one in part.values() for need in one.needs)
