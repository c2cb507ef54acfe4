"""Which rules must hold for a tileset of splats (GT)?"""

__all__ = ["TILESET_RULES", "all_rules"]

from functools import cache

from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation.rule import Registry
from gsgen.runtime.scene_checks.rules import SCENE_RULES
from gsgen.tiles.validation.rules.contents import (
    content_whole,
    contents_hold_splats,
    counts_agree,
    extensions_required,
    spz_version,
)
from gsgen.tiles.validation.rules.files import (
    content_size,
    draft_names,
    errors_told,
    hashes_match,
    leaves_match_source,
    no_empty_tiles,
    qualities_told,
)
from gsgen.tiles.validation.rules.neural import neural_content
from gsgen.tiles.validation.rules.pictures import levels_agree, tile_visible
from gsgen.tiles.validation.rules.structure import (
    child_in_parent,
    geometric_error_falls,
    leaf_error,
    subtree_bitstreams,
    tileset_schema,
    transform_similarity,
    uri_stays,
)
from gsgen.tiles.validation.rules.values import children_cover, splats_in_box, values_valid

TILESET_RULES = (
    tileset_schema,
    child_in_parent,
    splats_in_box,
    geometric_error_falls,
    content_whole,
    counts_agree,
    extensions_required,
    children_cover,
    spz_version,
    uri_stays,
    transform_similarity,
    values_valid,
    subtree_bitstreams,
    leaves_match_source,
    hashes_match,
    content_size,
    leaf_error,
    no_empty_tiles,
    draft_names,
    neural_content,
    tile_visible,
    levels_agree,
    contents_hold_splats,
    qualities_told,
    errors_told,
)
"""All rules, in order of their ids; the entry point names this."""


@cache
def all_rules() -> Registry:
    """Return all installed rules: those of models, of tilesets and of scene files."""
    models = installed_rules()
    rules = [*models.rules.values(), *TILESET_RULES, *SCENE_RULES]
    return Registry.from_rules(rules, models.backends.values())
