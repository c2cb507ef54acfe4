"""Rules (GT) of level ``render``: the drawn tiles show something, and the levels agree."""

__all__ = ["MIN_SIMILARITY", "levels_agree", "tile_visible"]

from collections.abc import Iterator
from typing import Final

from gsgen.contract.spec.layout import CULL_OPACITY
from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Violation
from gsgen.tiles.validation.inspected import InspectedTileset
from gsgen.tiles.validation.rules.reporting import SCHEMA_RULE, tileset_rule

MIN_SIMILARITY: Final = 0.5
"""SSIM between a tile and its children: good levels have .7 to .9, a parent that is turned,
shifted by a quarter of its size, or has the colours of other splats, less than .5."""

_PREREQUISITE_RULES: Final = (SCHEMA_RULE, "GT005", "GT006", "GT010", "GT011", "GT012")


@tileset_rule("GT021", Severity.ERROR, needs=_PREREQUISITE_RULES, level=Level.RENDER)
def tile_visible(inspected: InspectedTileset) -> Iterator[Violation]:
    """The root tile and a leaf tile are visible from cameras around them.

    Why:
        All numbers may be valid, and the screen still be empty: opacities or scales were not
        activated, or have the unit of another scene.

    Hint:
        Draw the tileset with `gsgen render`. Check the opacities and scales of the named content.
        The root is drawn, and the leaf with the most splats, each from three sides.
    """
    for tile in inspected.drawn.tiles if inspected.drawn else ():
        if not tile.covered >= CULL_OPACITY:
            yield Violation.at(
                f"content {tile.uri}",
                f"{tile.splats} splats, and no pixel is covered by more than {tile.covered:.2g}",
                f"at least {CULL_OPACITY:.2g} somewhere",
            )


@tileset_rule("GT022", Severity.WARNING, needs=(*_PREREQUISITE_RULES, "GT021"), level=Level.RENDER)
def levels_agree(inspected: InspectedTileset) -> Iterator[Violation]:
    """A tile looks like the tiles that replace it, with an SSIM of 0.5 or more.

    Why:
        If they differ, the picture jumps: a level is of another scene, lost its transform, or
        splats were dropped and others did not grow.

    Hint:
        Build the levels again, or state a larger geometric error. The root and one parent of leaves
        are compared with their children where the error is 16 pixels. Right levels have .7 to .9
        there; one that is turned, shifted by a quarter or has other colours less than .5.
    """
    for pair in inspected.drawn.levels if inspected.drawn else ():
        if not pair.ssim >= MIN_SIMILARITY:
            yield Violation.at(
                f"tile {pair.location}",
                f"SSIM {pair.ssim:.2f} to the {pair.children} contents that replace it, where its "
                f"error is {pair.pixels:.0f} pixels",
                f"at least {MIN_SIMILARITY}",
                certainty="possible",
            )
