"""Static rules (GT) of splat files: counts, digests, sizes, names."""

from collections.abc import Iterator
from typing import Final

from gsgen.contract.spec.severity import Severity
from gsgen.contract.spec.units import MEBIBYTE
from gsgen.contract.validation.finding import Violation
from gsgen.formats.glb.splats import EXTENSION_NAME
from gsgen.tiles.errors import ContentMissing
from gsgen.tiles.format.json_values import is_number
from gsgen.tiles.format.tileset import Tile
from gsgen.tiles.validation.headers import headers, primitives
from gsgen.tiles.validation.inspected import InspectedTileset
from gsgen.tiles.validation.kinds import TILE_CONTENT, TILESET
from gsgen.tiles.validation.rules.reporting import SCHEMA_RULE, certainty, tileset_rule

MAX_SPLATS: Final = 262_144
MAX_BYTES: Final = 8 << 20
_FLOAT32_STEP: Final = 1e-6  # to which errors are rounded, as a share
_TARGET_KINDS: Final = (TILESET, TILE_CONTENT)
_COMPLETE_FILE_RULES: Final = (SCHEMA_RULE, "GT005", "GT010", "GT011", "GT013")


@tileset_rule("GT014", Severity.ERROR, needs=_COMPLETE_FILE_RULES)
def leaves_match_source(inspected: InspectedTileset) -> Iterator[Violation]:
    """All leaves together have as many splats as the tileset declares for the scene.

    Why:
        A build that lost a part, or wrote one twice, looks right from afar.

    Hint:
        Build the tileset again; if it is right, correct source_splats.
    """
    tileset = inspected.tileset
    if tileset is None:
        return
    declared = {}
    if "source_splats" in tileset.metadata:
        declared["metadata.properties.source_splats"] = tileset.metadata["source_splats"]
    if inspected.record is not None:
        declared["gsgen.tiles.json, source_splats"] = inspected.record.source_splats
    leaves = sum(
        content.header.splats
        for content in inspected.contents
        if content.header and content.tile and content.tile.is_finest
    )
    for location, count in declared.items():
        if count != leaves:
            yield Violation.at(
                f"tileset {location}", f"{count!r:.40}", f"{leaves}, as the leaves have"
            )


@tileset_rule("GT015", Severity.ERROR, needs=(SCHEMA_RULE, "GT005", "GT010"))
def hashes_match(inspected: InspectedTileset) -> Iterator[Violation]:
    """Every content has the size and SHA-256 that the build record lists for it.

    Why:
        Names of tiles are kept in caches for ever: a file that changed under its name is seen
        by some users and not by others.

    Hint:
        Build the tileset again, and copy all of it. Without a record nothing is compared.
    """
    record = inspected.record
    if record is None:
        return
    for content, header in headers(inspected):
        uri, digest = content.content.uri, content.sha256
        entry = record.files.get(uri)
        if entry is None:
            yield Violation.at(
                f"content {uri}", f"not in {record.location}", "an entry for the content"
            )
        elif (entry.size, entry.sha256) != (header.size, digest):
            yield Violation.at(
                f"content {uri}",
                f"{header.size} bytes, SHA-256 {digest[:12]}…",
                f"{entry.size} bytes, {entry.sha256[:12]}…, as {record.location} lists",
            )


@tileset_rule("GT024", Severity.ERROR, needs=(SCHEMA_RULE, "GT005", "GT010"))
def qualities_told(inspected: InspectedTileset) -> Iterator[Violation]:
    """A tile's files, bytes and worth are those of its content at each quality.

    Why:
        A viewer asks for the file that shows most for its bytes. It plans by these numbers, and
        fetches by these addresses, before it has seen any file.

    Hint:
        Build the tileset again, and copy all of it.
    """
    tileset = inspected.tileset
    if tileset is None or not inspected.is_built_by_gsgen:
        return
    sizes = {content.content.uri: header.size for content, header in headers(inspected)}
    for tile in tileset.tiles():
        for actual, expected in _quality_faults(inspected, tile, sizes):
            yield Violation.at(f"tile {tile.location}, metadata", actual, expected)


def _quality_faults(
    inspected: InspectedTileset, tile: Tile, sizes: dict[str, int]
) -> Iterator[tuple[str, str]]:
    """Yield what a tile tells of its files, and what it should tell."""
    told, files = tile.file_sizes, tile.files
    if not told:
        return
    quality = inspected.tileset.metadata.get("quality", 0) if inspected.tileset else 0
    uri = tile.contents[0].uri
    own = min(quality, len(told) - 1) if isinstance(quality, int) and quality >= 0 else 0
    if files and (len(files) != len(told) or files[own] != uri):
        yield f"files {', '.join(files)}", f"{len(told)} files, {uri} at {own}"
        return
    for name, size in zip(files or (uri,), told if files else told[own : own + 1], strict=True):
        try:
            actual = sizes[name] if name in sizes else inspected.store.size(name)
        except ContentMissing:
            yield name, "a file that is there"
            continue
        if actual != size:
            yield f"{size} bytes of {name}", f"{actual}, as the file has"
    worth = tile.metadata.get("worth")
    entries = worth if isinstance(worth, list) else [1.0 if worth is None else worth]
    if not all(is_number(entry) and 0 <= entry <= 1 for entry in entries) or (
        worth is not None and len(entries) != len(told)
    ):
        yield f"worth {worth!r:.60}", f"{len(told)} numbers from 0 to 1"


@tileset_rule("GT025", Severity.ERROR, needs=(SCHEMA_RULE,))
def errors_told(inspected: InspectedTileset) -> Iterator[Violation]:
    """A tile's errors grow from its finest to its coarsest quality, from its geometric error on.

    Why:
        A viewer decides by them how fine a file is worth its bytes. One that tells less than it
        shows stays coarse on the screen.

    Hint:
        Build the tileset again. Without the property, the geometric error counts for all files.
    """
    tileset = inspected.tileset
    if tileset is None or not inspected.is_built_by_gsgen:
        return
    for tile in tileset.tiles():
        told, count = tile.metadata.get("error"), len(tile.file_sizes)
        if told is None or not count:
            continue
        entries = told if isinstance(told, list) else [told]  # one quality of implicit tiles
        least = tile.geometric_error * (1 - _FLOAT32_STEP)
        is_told = len(entries) == count and all(map(is_number, entries))
        if not (is_told and entries == sorted(entries) and entries[0] >= least):
            yield Violation.at(
                f"tile {tile.location}, metadata",
                f"error {told!r:.60}",
                f"{count} ascending numbers from {least:.4g} on",
            )


@tileset_rule("GT016", Severity.WARNING, needs=(SCHEMA_RULE,), kinds=_TARGET_KINDS)
def content_size(inspected: InspectedTileset) -> Iterator[Violation]:
    """A tile's content has at most 262,144 splats and 8 MiB.

    Why:
        A tile appears when all of it has come. Large ones come late and in jerks, and a viewer
        that needs a corner pays for the whole.

    Hint:
        Divide the tile: build with a smaller --leaf.
    """
    for content, header in headers(inspected):
        if header.splats > MAX_SPLATS or header.size > MAX_BYTES:
            yield Violation.at(
                f"content {content.content.uri}",
                f"{header.splats:,} splats, {header.size / MEBIBYTE:.1f} MiB",
                f"{MAX_SPLATS:,} splats and {MAX_BYTES >> 20} MiB at most",
            )


@tileset_rule("GT018", Severity.ERROR, needs=_COMPLETE_FILE_RULES)
def no_empty_tiles(inspected: InspectedTileset) -> Iterator[Violation]:
    """Every leaf has a content, and every content has splats.

    Why:
        An empty leaf that replaces its parent makes a hole; an empty file costs a request.

    Hint:
        Leave the tile out.
    """
    for content, header in headers(inspected):
        if header.primitives and not header.splats:
            yield Violation.at(f"content {content.content.uri}", "0 splats", "one at least")
    for tile in inspected.tileset.tiles() if inspected.tileset else ():
        if not tile.children and not tile.contents:
            yield Violation.at(
                f"tile {tile.location}",
                "a leaf without content",
                "content, or no leaf tile",
                certainty=certainty(inspected),
            )


@tileset_rule("GT019", Severity.WARNING, needs=(SCHEMA_RULE,), kinds=_TARGET_KINDS)
def draft_names(inspected: InspectedTileset) -> Iterator[Violation]:
    """Contents use the attribute names of the ratified glTF extension, not those of its drafts.

    Why:
        Viewers drop the names of drafts, one after the other; CesiumJS has dropped the first.

    Hint:
        Write the content again: POSITION, KHR_gaussian_splatting:ROTATION and so on, and
        KHR_gaussian_splatting_compression_spz_2 within KHR_gaussian_splatting.
    """
    for primitive in primitives(inspected):
        if primitive.drafts:
            names = ", ".join(primitive.drafts)
            yield Violation.at(
                f"content {primitive.location}", names, f"names of {EXTENSION_NAME} as ratified"
            )
