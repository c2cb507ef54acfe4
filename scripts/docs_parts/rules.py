"""Rules in tables; their pages come from :mod:`gsgen.contract.reporters.rule_pages`."""

from docs_parts.tables import table
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.rule import Registry
from gsgen.tiles.validation.rules import all_rules


def ours() -> Registry:
    """Return the rules of this project, without those of installed third parties.

    Ids of third parties' rules begin with a name and a slash.
    """
    registry = all_rules()
    contract_rules = [rule for rule in registry.rules.values() if "/" not in rule.id]
    return Registry.from_rules(contract_rules, registry.backends.values())


def by_level() -> str:
    """Return a table of the number and the families of rules of each level."""
    rows = []
    for level in Level:
        level_rules = [rule for rule in ours().rules.values() if rule.level is level]
        families = list(dict.fromkeys(rule.family for rule in level_rules))
        rows.append((f"`{level.word}`", str(len(level_rules)), ", ".join(families) or "–"))
    return table(("level", "rules", "families"), rows)
