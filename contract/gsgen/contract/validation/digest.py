"""SHA-256 digests of model files and of sets of validation rules."""

__all__ = ["digest", "rules_digest"]

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.rule import Rule

_CHUNK_BYTES = 1 << 20
# Hashing a larger file would take most of the time of a static validation.
_STATIC_BYTES = 64 << 20


def digest(path: Path, level: Level, size: int) -> str:
    """Return the SHA-256 of a model file; empty for a large file in a static validation."""
    if level < Level.VALUES and size >= _STATIC_BYTES:
        return ""
    hasher = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            hasher.update(chunk)
    return hasher.hexdigest()


def rules_digest(rules: Iterable[Rule]) -> str:
    """Return the SHA-256 of the rules' declarations: equal digests mean equal rules."""
    declarations = [
        (
            *(rule.id, rule.slug, rule.severity.word, rule.level.word, rule.scope),
            *(rule.statement, rule.rationale, rule.hint, rule.evidence),
            *(rule.needs, rule.kinds, rule.target, rule.limit),
        )
        for rule in rules
    ]
    text = json.dumps(declarations, ensure_ascii=True, separators=(",", ":"))
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"
