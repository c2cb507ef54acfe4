"""Validates a scene file by the rules GC."""

__all__ = ["validate_scene"]

import hashlib
import os
import time
from pathlib import Path

from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.engine import Progress, ignore_progress
from gsgen.contract.validation.outcomes import ResultCollector
from gsgen.contract.validation.report import LevelOutcome, Report
from gsgen.contract.validation.rule import Registry, in_dependency_order
from gsgen.contract.validation.settings import Settings
from gsgen.runtime.scene_checks.inspected_scene import inspect_scene
from gsgen.runtime.scene_checks.rules import SCENE, SCENE_RULES


def validate_scene(
    path: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    registry: Registry | None = None,
    progress: Progress = ignore_progress,
) -> Report:
    """Validate a scene file by the rules of its fields, segments and sound; return the report.

    The models that it names have reports of their own.

    Args:
        path: The scene file.
        settings: How far to go (static: fields, files and manifests; values: segments are run
            around their seams), and severities.
        registry: The rules to check; by default, all installed rules.
        progress: Called with a few words whenever a new stage begins.
    """
    start, path = time.perf_counter(), Path(path)
    settings = (settings or Settings()).for_model(path)
    if registry is None:
        registry = Registry.from_rules([*installed_rules().rules.values(), *SCENE_RULES])
    registry = registry.of_files("scene", settings.only)
    progress(f"reading {path.name}")
    shows = settings.level >= Level.VALUES
    inspected = inspect_scene(path, settings.limits, shows=shows, progress=progress)
    results = ResultCollector(registry=registry, settings=settings, kind=SCENE)
    for rule in in_dependency_order(registry.rules.values()):
        if not results.is_ready(rule):
            continue
        if rule.level > settings.level:
            results.skip([rule], f"level {rule.level.word} was not asked for")
        elif rule.level is Level.VALUES and inspected.unshown_reason:
            results.skip([rule], inspected.unshown_reason)
        else:
            results.check(rule, inspected)
            results.settle([rule], items=max(len(inspected.clips), 1))
    levels = [LevelOutcome(level=Level.STATIC, ran=True)]
    if shows:
        reason = inspected.unshown_reason
        levels.append(LevelOutcome(level=Level.VALUES, ran=not reason, reason=reason))
    data = path.read_bytes()
    return results.report(str(path), levels, start, len(data), hashlib.sha256(data).hexdigest())
