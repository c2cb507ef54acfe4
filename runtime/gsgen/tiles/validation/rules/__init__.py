"""Which rules must hold for a tileset of splats (GT)?"""

__all__ = ["TILESET_RULES", "all_rules"]

from functools import cache
from typing import Final

from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation.rule import Registry, Rule, rules_in
from gsgen.runtime.scene_checks.rules import SCENE_RULES
from gsgen.tiles.validation.rules import contents, files, neural, pictures, structure, values

_FAMILIES: Final = (structure, contents, values, files, neural, pictures)

TILESET_RULES: Final[tuple[Rule, ...]] = tuple(
    sorted((rule for family in _FAMILIES for rule in rules_in(family)), key=lambda rule: rule.id)
)
"""All rules, in order of their ids."""


@cache
def all_rules() -> Registry:
    """Return all installed rules: those of models, of tilesets and of scene files."""
    models = installed_rules()
    rules = [*models.rules.values(), *TILESET_RULES, *SCENE_RULES]
    return Registry.from_rules(rules, models.backends.values())
