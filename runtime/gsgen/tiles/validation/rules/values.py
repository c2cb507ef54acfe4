"""Rules (GT) of decoded splats: positions within volumes, and valid values."""

from collections.abc import Iterator
from typing import Final

from gsgen.contract.spec.severity import Level, Severity
from gsgen.contract.validation.finding import Violation
from gsgen.tiles.errors import Fault
from gsgen.tiles.validation.inspected import InspectedTileset
from gsgen.tiles.validation.kinds import TILE_CONTENT, TILESET
from gsgen.tiles.validation.rules.reporting import SCHEMA_RULE, certainty, faults_of, tileset_rule

_PREREQUISITE_RULES: Final = (SCHEMA_RULE, "GT005", "GT011", "GT012")


@tileset_rule("GT003", Severity.ERROR, needs=_PREREQUISITE_RULES, level=Level.VALUES)
def splats_in_box(inspected: InspectedTileset) -> Iterator[Violation]:
    """Splats lie in the bounding volume of their content, out to three standard deviations.

    Why:
        Viewers cull by volumes: a splat that sticks out blinks at the edges of the picture,
        and is missing where its tile is not loaded.

    Hint:
        Measure the box of the stored splats, 3√Σ along each axis around every centre, and grow the
        volumes above it. A tileset that does not declare the profile of gsgen fails only where
        centres are outside.
    """
    for content in inspected.contents:
        outside = content.values.outside if content.values else None
        if outside is not None:
            violation_certainty = "confirmed" if outside.centers else certainty(inspected)
            yield Violation.at(
                f"content {content.content.uri}",
                f"{outside.count} of {outside.total} splats reach out at 3σ "
                f"({outside.centers} by their centre); row {outside.row} by "
                f"{outside.distance:.3g}",
                "all within the volume of the content, or of its tile",
                certainty="confirmed" if violation_certainty == "confirmed" else "possible",
            )


@tileset_rule(
    "GT008", Severity.ERROR, needs=(*_PREREQUISITE_RULES, "GT010", "GT013"), level=Level.VALUES
)
def children_cover(inspected: InspectedTileset) -> Iterator[Violation]:
    """If children replace a tile, the centre of each splat of the tile lies in a child.

    Why:
        Replacing takes the parent away: a part that no child covers is a hole that opens when the
        viewer comes near.

    Hint:
        Add the missing children. Centres may lie outside by the geometric error of the tile.
    """
    for content in inspected.contents:
        uncovered_splats = content.values.uncovered if content.values else None
        if uncovered_splats is not None:
            yield Violation.at(
                f"content {content.content.uri}",
                f"{uncovered_splats.count} of {uncovered_splats.total} splats lie in no child; row {uncovered_splats.row} is "
                f"{uncovered_splats.distance:.3g} from the nearest",
                "every centre in a child's volume",
            )


@tileset_rule(
    "GT012",
    Severity.ERROR,
    needs=(SCHEMA_RULE, "GT005", "GT006"),
    kinds=(TILESET, TILE_CONTENT),
    level=Level.VALUES,
)
def values_valid(inspected: InspectedTileset) -> Iterator[Violation]:
    """Splat values are finite, quaternions unit, scales 0 or more, opacities in [0, 1].

    Why:
        One NaN can take a whole tile off the screen, and an opacity above 1 burns in.

    Hint:
        Activate what training leaves raw: σ(opacity), e^scale, normalised quaternions.
    """
    yield from faults_of(inspected, Fault.VALUES)
