"""Static rules (GT) of ``tileset.json``: the tree of tiles, volumes and transforms."""

from collections.abc import Iterator
from typing import Final

import numpy as np

from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.tiles.errors import Fault
from gsgen.tiles.format.tileset import Tile
from gsgen.tiles.validation.inspected import InspectedTileset
from gsgen.tiles.validation.rules.reporting import SCHEMA_RULE, certainty, faults_of, tileset_rule

_SIZE_TOLERANCE: Final = 5e-3  # of the parent's size: curved regions are compared at 18 points
_ABSOLUTE_TOLERANCE: Final = 1e-6
_SCALE_TOLERANCE: Final = 1e-4


@tileset_rule("GT001", Severity.ERROR)
def tileset_schema(inspected: InspectedTileset) -> Iterator[Violation]:
    """Every ``tileset.json`` follows the 3D Tiles 1.1 schema; required extensions are supported.

    Why:
        A viewer reads as far as it can: a tile with a wrong member is left out without a word,
        or the whole tileset is.

    Hint:
        Correct the member that is named. The schema is part of the 3D Tiles specification (OGC
        22-025r4).
    """
    yield from faults_of(inspected, Fault.SCHEMA)


@tileset_rule("GT002", Severity.ERROR, needs=(SCHEMA_RULE,))
def child_in_parent(inspected: InspectedTileset) -> Iterator[Violation]:
    """The bounding volume of every tile and content lies within that of the tile above it.

    Why:
        Viewers skip a tile and all below it when its volume is out of sight. What sticks out
        vanishes at the edges of the picture.

    Hint:
        Grow the volumes bottom up: a tile's holds its content and all its children.
    """
    tileset = inspected.tileset
    if tileset is None:
        return
    for tile in tileset.tiles():
        to_world = tileset.transform @ tile.transform
        volume = tile.volume.transformed(to_world)
        inner = [
            (f"tile {child.location}", child.volume, tileset.transform @ child.transform)
            for child in tile.children
        ]
        inner += [
            (f"content {content.location}", content.volume, to_world)
            for content in tile.contents
            if content.volume is not None
        ]
        for subject, inner_volume, transform in inner:
            overshoot = float(volume.outside(inner_volume.transformed(transform).samples()).max())
            if not overshoot <= _SIZE_TOLERANCE * volume.size + _ABSOLUTE_TOLERANCE:
                yield Violation.at(
                    subject,
                    f"its volume reaches {overshoot:.4g} out of its tile's",
                    f"a volume within that of {tile.location}",
                )


@tileset_rule("GT004", Severity.ERROR, needs=(SCHEMA_RULE,))
def geometric_error_falls(inspected: InspectedTileset) -> Iterator[Violation]:
    """The geometric error of a tile is not larger than that of its parent.

    Why:
        A viewer that refines down to an error would stop above a tile that is worse than its
        parent, or refine it without end.

    Hint:
        Let errors fall from level to level, to 0 for the leaves.
    """
    pending = [(inspected.tileset.root, inspected.tileset.root)] if inspected.tileset else []
    while pending:
        tile, bound = pending.pop()
        if tile.geometric_error > bound.geometric_error * (1 + _ABSOLUTE_TOLERANCE):
            yield Violation.at(
                f"tile {tile.location}",
                f"geometric error {tile.geometric_error:g}",
                f"{bound.geometric_error:g} or less, as {bound.location} has",
            )
        # A tile that only names an external tileset draws nothing: its error stands for no picture.
        above = bound if _names_external_only(tile) else tile
        pending += [(child, above) for child in reversed(tile.children)]


def _names_external_only(tile: Tile) -> bool:
    file = tile.location.split(", ")[0]
    return not tile.contents and any(
        child.location.split(", ")[0] != file for child in tile.children
    )


@tileset_rule("GT010", Severity.ERROR, needs=(SCHEMA_RULE,))
def uri_stays(inspected: InspectedTileset) -> Iterator[Violation]:
    """Every uri stays in the folder of the tileset, and no tileset contains itself.

    Why:
        A downloaded tileset could make a viewer fetch from anywhere, or for ever.

    Hint:
        Put all files below the folder of tileset.json, and refer to them by relative uris.
    """
    yield from faults_of(inspected, Fault.URI)


@tileset_rule("GT011", Severity.ERROR, needs=(SCHEMA_RULE,))
def transform_similarity(inspected: InspectedTileset) -> Iterator[Violation]:
    """Splats are placed by rotations, positive scales equal along every axis, and translations.

    Why:
        Splats are ellipsoids with colours by direction: a mirrored or sheared frame changes
        both in ways that viewers do not follow, and errors in metres mean nothing in it.

    Hint:
        Move shear and mirroring into the splats, and keep a similarity for the tile.
    """
    yield from faults_of(inspected, Fault.TRANSFORM)
    tileset = inspected.tileset
    for content in inspected.contents if tileset else ():
        if content.tile is None or content.header is None or not content.header.splats:
            continue
        assert tileset is not None
        linear = (tileset.transform @ content.tile.transform)[:3, :3]
        sizes = np.linalg.svd(linear, compute_uv=False)
        if sizes[0] > sizes[2] * (1 + _SCALE_TOLERANCE):
            yield Violation.at(
                f"tile {content.tile.location}",
                f"its transforms scale splats from {sizes[2]:g} to {sizes[0]:g}",
                "the same scale along every axis",
            )


@tileset_rule("GT013", Severity.ERROR, needs=(SCHEMA_RULE,))
def subtree_bitstreams(inspected: InspectedTileset) -> Iterator[Violation]:
    """Subtrees have the sizes, bitstreams and tables that their headers promise.

    Why:
        The tree of an implicit tileset stands in these bits alone: one that is shifted asks for
        files that are not there, and hides those that are.

    Hint:
        Write the subtree again: a bit for each tile, level by level along Morton's curve, lowest
        bit first, and every available tile below an available one.
    """
    yield from faults_of(inspected, Fault.SUBTREE)


@tileset_rule("GT017", Severity.ERROR, needs=(SCHEMA_RULE,))
def leaf_error(inspected: InspectedTileset) -> Iterator[Violation]:
    """Leaves have a geometric error of 0, and a root with tiles below it more than 0.

    Why:
        A root with error 0 is never refined: the scene stays coarse. A leaf with an error looks
        as if something finer were missing, so that viewers ask for it again.

    Hint:
        Give leaves 0, and tiles above them their distance from the leaves, in metres.
    """
    tileset = inspected.tileset
    if tileset is None:
        return
    root = tileset.root
    if root.children and not root.geometric_error > 0:
        yield Violation.at(f"tile {root.location}", "geometric error 0", "more than 0")
    for tile in tileset.tiles():
        if not tile.children and tile.contents and tile.geometric_error > 0:
            yield Violation.at(
                f"tile {tile.location}",
                f"a leaf with geometric error {np.float64(tile.geometric_error):g}",
                "0",
                certainty=certainty(inspected),
            )
