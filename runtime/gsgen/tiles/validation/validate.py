"""Validates a tileset or one content file by the rules GT."""

__all__ = ["validate"]

import hashlib
import os
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.engine import Progress, ignore_progress
from gsgen.contract.validation.outcomes import ResultCollector
from gsgen.contract.validation.report import LevelOutcome, Report
from gsgen.contract.validation.rule import Registry, Rule, in_dependency_order
from gsgen.contract.validation.settings import Settings
from gsgen.formats.tileset_paths import INDEX_FILE
from gsgen.runtime.scene_checks.validate import validate_scene
from gsgen.runtime.sources.scene_file import is_scene_file
from gsgen.tiles.errors import TilesetInvalid
from gsgen.tiles.stores.opening import TILESET_KINDS, address_of, open_store
from gsgen.tiles.stores.store import Store
from gsgen.tiles.validation.content_inspection import inspect_content_file, inspect_tileset
from gsgen.tiles.validation.headers import headers
from gsgen.tiles.validation.inspected import InspectedTileset
from gsgen.tiles.validation.kinds import TILE_CONTENT, TILESET
from gsgen.tiles.validation.rules import all_rules

_CONTENT_SUFFIXES: Final = (".glb", ".gltf")
_CONTENT_KINDS: Final = ("glb", "glb-splats", "gltf", "gltf-splats")
_NOT_DRAWN_REASON: Final = "the rules that drawing needs do not hold"


def validate(
    path: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    registry: Registry | None = None,
    progress: Progress = ignore_progress,
) -> Report:
    """Validate a tileset, a tile's content file or a scene file, and return the report.

    Args:
        path: ``tileset.json``, its folder, ``.3tz``, ``.glb``, ``.gltf``, or an address; or a scene
            file, see :func:`gsgen.runtime.scene_checks.validate.validate_scene`.
        settings: How far to go (static: JSON and headers; values: all splats; render: pictures of
            two tiles and their children), and severities.
        registry: The rules to check; by default, all installed rules.
        progress: Called with a few words whenever a new stage begins.
    """
    start = time.perf_counter()
    path = Path(path)
    if path.name != INDEX_FILE and is_scene_file(path):
        return validate_scene(path, settings, registry=registry, progress=progress)
    settings = (settings or Settings()).for_model(path)
    registry = (registry or all_rules()).of_files("tileset", settings.only)
    progress(f"reading {path.name}")
    kind = TILE_CONTENT if path.suffix.lower() in _CONTENT_SUFFIXES else TILESET
    kinds = _CONTENT_KINDS if kind == TILE_CONTENT else ()
    store, index = open_store(path, kinds=(*TILESET_KINDS, *kinds))
    with store:
        inspected = _inspect(store, index, kind, path, settings, progress)
        results = ResultCollector(registry=registry, settings=settings, kind=kind)
        _check_tileset(results, inspected, settings.level, progress)
        size, digest = _index_digest(store, index)
    levels = _level_outcomes(settings.level, inspected)
    return results.report(address_of(path) or str(path), levels, start, size, digest)


def _inspect(
    store: Store,
    index: str,
    kind: str,
    path: Path,
    settings: Settings,
    progress: Callable[[str], None],
) -> InspectedTileset:
    decode, seconds = settings.level >= Level.VALUES, settings.limits.seconds
    if kind == TILE_CONTENT:
        store.size(index)  # raises where there is no such file
        return inspect_content_file(store, index, decode=decode, seconds=seconds)
    return inspect_tileset(
        store, index, decode=decode, seconds=seconds, progress=progress, name=str(path)
    )


def _check_tileset(
    results: ResultCollector,
    inspected: InspectedTileset,
    level: Level,
    progress: Callable[[str], None],
) -> None:
    """Check the tileset rules of the requested levels in order of dependency; skip the others."""
    items = max(len(inspected.contents), 1)
    for rule in in_dependency_order(results.registry.rules.values()):
        if not results.is_ready(rule):
            continue
        if rule.level > level:
            results.skip([rule], f"level {rule.level.word} was not asked for")
            continue
        if rule.level is Level.RENDER:
            _draw(inspected, progress)
        results.check(rule, inspected)
        reason = _incomplete_reason(rule, inspected)
        if reason and not results.has_failing_finding(rule):
            results.skip([rule], reason)
        results.settle([rule], items=items)


def _incomplete_reason(rule: Rule, inspected: InspectedTileset) -> str:
    """Return why a rule checked only a part of the tileset; empty if it checked everything."""
    if rule.level >= Level.VALUES and inspected.undecoded_reason:
        return f"{inspected.undecoded_reason} (see --timeout)"
    if rule.level is Level.RENDER:
        return inspected.undrawn_reason or (
            inspected.drawn.skipped.get(rule.id, "") if inspected.drawn else ""
        )
    return ""


def _draw(inspected: InspectedTileset, progress: Callable[[str], None]) -> None:
    """Draw tiles of the tileset once, or note why nothing can be drawn."""
    if inspected.drawn is not None or inspected.undrawn_reason or inspected.tileset is None:
        return
    if find_spec("wgpu") is None:
        inspected.undrawn_reason = "wgpu is not installed: pip install 'gsgen[runtime]'"
        return
    from gsgen.runtime.errors import CapacityExceeded, DeviceUnavailable
    from gsgen.tiles.validation.drawing import draw_tileset

    progress("drawing tiles")
    counts = {
        content.content.uri: sum(primitive.count for primitive in header.primitives)
        for content, header in headers(inspected)
    }
    try:
        inspected.drawn = draw_tileset(inspected.tileset, inspected.store, counts)
    except (DeviceUnavailable, CapacityExceeded) as error:
        inspected.undrawn_reason = (
            f"{error.where}: {error.message}" if error.where else error.message
        )


def _level_outcomes(requested: Level, inspected: InspectedTileset) -> Iterable[LevelOutcome]:
    """Yield the outcome of every requested validation level that applies to tilesets."""
    yield LevelOutcome(level=Level.STATIC, ran=True)
    if requested >= Level.VALUES:
        yield LevelOutcome(level=Level.VALUES, ran=True)
    if requested >= Level.RENDER:
        is_drawn = inspected.drawn is not None
        reason = "" if is_drawn else inspected.undrawn_reason or _NOT_DRAWN_REASON
        yield LevelOutcome(level=Level.RENDER, ran=is_drawn, reason=reason)


def _index_digest(store: Store, index: str) -> tuple[int, str]:
    with suppress(TilesetInvalid):
        data = store.read(index)
        return len(data), hashlib.sha256(data).hexdigest()
    return 0, ""
