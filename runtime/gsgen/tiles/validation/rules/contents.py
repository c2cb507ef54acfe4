"""Static rules (GT) of content headers: completeness, counts, extensions, SPZ version."""

from collections.abc import Iterator
from typing import Final

from gsgen.contract.spec.severity import Severity
from gsgen.contract.validation.finding import Violation
from gsgen.formats.glb.splats import EXTENSION_NAME
from gsgen.tiles.errors import Fault
from gsgen.tiles.format.extensions import CONTENT_EXTENSION, SPZ_EXTENSION
from gsgen.tiles.gltf.spz_quality import SPZ_VERSION
from gsgen.tiles.validation.headers import headers, primitives
from gsgen.tiles.validation.inspected import InspectedTileset
from gsgen.tiles.validation.kinds import TILE_CONTENT, TILESET
from gsgen.tiles.validation.rules.reporting import SCHEMA_RULE, faults_of, tileset_rule

_TARGET_KINDS: Final = (TILESET, TILE_CONTENT)


@tileset_rule("GT005", Severity.ERROR, needs=(SCHEMA_RULE,), kinds=_TARGET_KINDS)
def content_whole(inspected: InspectedTileset) -> Iterator[Violation]:
    """Every file that the tileset names exists, and is complete glTF 2.0.

    Why:
        A tile that cannot be loaded leaves a hole, or keeps its coarse parent for ever.

    Hint:
        Copy or build the tileset again. A file that ends early was most often cut by a copy.
    """
    yield from faults_of(inspected, Fault.CONTENT)
    for content, header in headers(inspected):
        if not header.primitives and content.tile is None:
            yield Violation.at(
                f"content {content.content.uri}",
                "no splats in the scene",
                f"a mesh of points with {EXTENSION_NAME}",
            )
    for primitive in primitives(inspected):
        for text in primitive.conforms:
            yield Violation.at(f"content {primitive.location}", text, f"as {EXTENSION_NAME} says")


@tileset_rule("GT023", Severity.WARNING, needs=(SCHEMA_RULE,))
def contents_hold_splats(inspected: InspectedTileset) -> Iterator[Violation]:
    """Every content holds splats; what others hold is not looked at.

    Why:
        The rules are about splats. A viewer of splats draws nothing for other contents.

    Hint:
        Check the named contents with the glTF validator of Khronos.
    """
    for content, header in headers(inspected):
        if content.tile is not None and not header.primitives:
            yield Violation.at(
                f"content {content.content.uri}",
                "no splats in the scene: not looked at",
                f"a mesh of points with {EXTENSION_NAME}",
            )


@tileset_rule("GT006", Severity.ERROR, needs=(SCHEMA_RULE,), kinds=_TARGET_KINDS)
def counts_agree(inspected: InspectedTileset) -> Iterator[Violation]:
    """Accessors, SPZ header and metadata of a content declare the same number of splats.

    Why:
        Viewers allocate by one of the numbers and fill by another: the splats between
        the two are rubbish on the screen, or a crash.

    Hint:
        Write the accessors' counts and the metadata from the splats that are stored.
    """
    yield from faults_of(inspected, Fault.COUNTS)
    for primitive in primitives(inspected):
        if len(set(primitive.counts.values())) > 1:
            text = ", ".join(f"{name} {count}" for name, count in primitive.counts.items())
            yield Violation.at(f"content {primitive.location}", text, "equal numbers of splats")
    for content in inspected.contents:
        tile, header = content.tile, content.header
        if tile is None or header is None or len(tile.contents) > 1:
            continue
        declared = tile.metadata.get("splats")
        if declared is not None and declared != header.splats:
            yield Violation.at(
                f"tile {tile.location}",
                f"metadata says {declared!r:.40} splats",
                f"{header.splats}, as {content.content.uri} has",
            )


@tileset_rule("GT007", Severity.ERROR, needs=(SCHEMA_RULE, "GT005"))
def extensions_required(inspected: InspectedTileset) -> Iterator[Violation]:
    """A tileset's 3DTILES_content_gltf requires the splat extensions that its contents use.

    Why:
        CesiumJS 1.145 decides by this list whether it draws splats at all: without it the
        tileset loads, and nothing is seen.

    Hint:
        List KHR_gaussian_splatting, and for SPZ KHR_gaussian_splatting_compression_spz_2, under
        extensions.3DTILES_content_gltf.extensionsRequired, and 3DTILES_content_gltf under
        extensionsUsed.
    """
    tileset = inspected.tileset
    sets = list(primitives(inspected))
    if tileset is None or not sets:
        return
    needed = [EXTENSION_NAME]
    if any(primitive.spz_version is not None for primitive in sets):
        needed.append(SPZ_EXTENSION)
    declared = tileset.content_extensions or ()
    missing = [name for name in needed if name not in declared]
    location = f"tileset {tileset.index}, extensions.{CONTENT_EXTENSION}.extensionsRequired"
    if missing:
        declared_names = ", ".join(declared) or "nothing"
        yield Violation.at(location, f"{declared_names:.200}", " and ".join(needed))
    elif CONTENT_EXTENSION not in tileset.extensions_used:
        location = f"tileset {tileset.index}, extensionsUsed"
        yield Violation.at(location, f"no {CONTENT_EXTENSION}", f"{CONTENT_EXTENSION} among them")


@tileset_rule("GT009", Severity.ERROR, needs=(SCHEMA_RULE,), kinds=_TARGET_KINDS)
def spz_version(inspected: InspectedTileset) -> Iterator[Violation]:
    """SPZ data in a tile's content are of version 2.

    Why:
        The extension is written for version 2, and viewers decode no other: a later one loads
        without a message and shows nothing, or wrong rotations.

    Hint:
        Encode the splats as SPZ version 2, say with `gsgen convert --spz-version 2`.
    """
    for primitive in primitives(inspected):
        if primitive.spz_version not in (None, SPZ_VERSION):
            yield Violation.at(
                f"content {primitive.location}",
                f"SPZ version {primitive.spz_version}",
                f"version {SPZ_VERSION}",
            )
