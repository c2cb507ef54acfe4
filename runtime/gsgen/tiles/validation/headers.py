"""Yields the headers of tile contents, each file once."""

__all__ = ["headers", "primitives"]

from collections.abc import Iterator

from gsgen.tiles.gltf.decoding import ContentHeader, SplatPrimitive
from gsgen.tiles.validation.inspected import InspectedContent, InspectedTileset


def headers(inspected: InspectedTileset) -> Iterator[tuple[InspectedContent, ContentHeader]]:
    """Yield each content file with its header, once: at the first tile content that names it."""
    known_uris: set[str] = set()
    for content in inspected.contents:
        if content.header is not None and content.content.uri not in known_uris:
            known_uris.add(content.content.uri)
            yield content, content.header


def primitives(inspected: InspectedTileset) -> Iterator[SplatPrimitive]:
    """Yield the glTF primitives with splats of all files, each once."""
    for _, header in headers(inspected):
        yield from header.primitives
