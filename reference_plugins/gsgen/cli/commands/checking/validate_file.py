"""Validates one file by the rules of its kind: a model, a tileset, or a scene file."""

__all__ = ["every_rule", "is_tileset", "validate_file"]

from pathlib import Path

from gsgen.contract.process.atomic_files import MODEL_SUFFIX
from gsgen.contract.validation.engine import Progress
from gsgen.contract.validation.report import Report
from gsgen.contract.validation.rule import Registry
from gsgen.contract.validation.settings import Settings
from gsgen.contract.validator import validate


def is_tileset(path: Path) -> bool:
    """Return whether a path names a scene file, a tileset, or a file with the content of a tile."""
    if path.suffix.lower() == MODEL_SUFFIX:
        return False
    from gsgen.formats.tileset_paths import names_tileset_or_content

    return names_tileset_or_content(path)


def validate_file(path: Path, settings: Settings, progress: Progress) -> Report:
    """Validate a model, a scene file, a tileset or a tile's content, and return the report."""
    if not is_tileset(path):
        return validate(path, settings, progress=progress)
    from gsgen.tiles.validation.validate import validate as validate_tileset

    return validate_tileset(path, settings, progress=progress)


def every_rule() -> Registry:
    """Return all installed rules: those of models, of tilesets and of scene files."""
    from gsgen.tiles.validation.rules import all_rules

    return all_rules()
