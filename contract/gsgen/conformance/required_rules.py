"""Finds the rules that another rule depends on."""

__all__ = ["needed_by"]

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.gates import MODEL_RUNS
from gsgen.contract.validation.rule import Registry, Rule


def needed_by(rule: Rule, registry: Registry) -> Registry:
    """Return ``rule`` with all rules that must hold before it is checked, in catalogue order."""
    rule_ids: set[str] = set()
    queue = [rule.id, *(() if rule.level == Level.STATIC else (MODEL_RUNS,))]
    while queue:
        name = queue.pop()
        if name not in rule_ids and name in registry.rules:
            rule_ids.add(name)
            queue.extend(registry.rules[name].needs)
    return Registry.of(rule for rule in registry.rules.values() if rule.id in rule_ids)
