"""Finds the validation rules that another rule depends on, so that they are checked first."""

__all__ = ["needed_by"]

from gsgen.contract.validation.rule import Registry, Rule


def needed_by(rule: Rule, registry: Registry) -> Registry:
    """Return a rule together with all rules that must pass before, in catalogue order."""
    return Registry(registry.with_needs([rule.id]).rules)
