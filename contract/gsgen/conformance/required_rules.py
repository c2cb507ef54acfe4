"""Which rules must be judged so that one of them can be."""

__all__ = ["needed_by"]

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.gates import MODEL_RUNS
from gsgen.contract.validation.rule import Registry, Rule


def needed_by(rule: Rule, registry: Registry) -> Registry:
    """Return ``rule`` with all that must hold before it can be judged, in catalogue order."""
    rule_ids: set[str] = set()
    queue = [rule.id, *(() if rule.level == Level.STATIC else (MODEL_RUNS,))]
    while queue:
        name = queue.pop()
        if name not in rule_ids and name in registry.rules:
            rule_ids.add(name)
            queue.extend(registry.rules[name].needs)
    return Registry.of(rule for rule in registry.rules.values() if rule.id in rule_ids)
