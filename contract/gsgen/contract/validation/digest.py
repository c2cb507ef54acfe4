"""Digests that tell one file, or one set of rules, from another."""

__all__ = ["digest", "rules_digest"]

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path

from gsgen.contract.spec.severity import Level
from gsgen.contract.validation.rule import Rule

_CHUNK = 1 << 20
# Hashing more would be most of the time that a static validation takes.
_STATIC_BYTES = 64 << 20


def digest(path: Path, level: Level, size: int) -> str:
    """Return the SHA-256 of a file; nothing where it costs more than judging up to ``level``."""
    if level < Level.VALUES and size >= _STATIC_BYTES:
        return ""
    made = hashlib.sha256()
    with path.open("rb") as file:
        while chunk := file.read(_CHUNK):
            made.update(chunk)
    return made.hexdigest()


def rules_digest(rules: Iterable[Rule]) -> str:
    """Return the SHA-256 over what rules declare: equal where models are judged by the same."""
    said = [
        (
            *(one.id, one.slug, one.severity.word, one.level.word, one.scope),
            *(one.statement, one.why, one.hint, one.evidence),
            *(one.needs, one.kinds, one.target, one.limit),
        )
        for one in rules
    ]
    text = json.dumps(said, ensure_ascii=True, separators=(",", ":"))
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"
