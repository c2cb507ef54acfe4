"""The public function that validates a model by every installed rule."""

__all__ = ["validate"]

import os
from pathlib import Path

from gsgen.contract.process.atomic_files import MODEL_SUFFIX
from gsgen.contract.rules.catalogue import installed_rules
from gsgen.contract.validation.engine import Progress, ignore_progress, validate_with
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings


def validate(
    path: str | os.PathLike[str],
    settings: Settings | None = None,
    *,
    registry: Registry | None = None,
    progress: Progress = ignore_progress,
) -> Report:
    """Validate the model at ``path`` by every installed rule and return the report.

    Args:
        path: An ONNX file, its address, or a ZIP archive of it; ``gsgen.tiles.validate`` validates
            tilesets.
        settings: Level, target, limits and severities.
        registry: The rules to check; by default, all installed rules.
        progress: Called with a short text at the start of each stage.

    Raises:
        ModelUnreadable: The file is not an ONNX model.
        InputUnreadable: The file at an address cannot be had.
    """
    settings, registry = settings or Settings(), registry or installed_rules()
    if settings.only:
        registry = registry.with_needs(settings.only)
    models = registry.of_scope(tilesets=False)
    return validate_with(models, _on_disk(Path(path)), settings, progress=progress)


def _on_disk(path: Path) -> Path:
    """Return the file of a path, address or archive; a file named as a model is one."""
    if path.suffix.lower() == MODEL_SUFFIX and path.exists():
        return path
    from gsgen.contract.model.fetched_inputs import local_file

    return local_file(path)
