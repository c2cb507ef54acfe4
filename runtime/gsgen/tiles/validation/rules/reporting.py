"""Converts faults of reading a tileset to violations of rules."""

__all__ = ["SCHEMA_RULE", "certainty", "faults_of", "tileset_rule"]

from collections.abc import Iterator
from functools import partial
from typing import Final

from gsgen.contract.validation.finding import Certainty, Violation
from gsgen.contract.validation.rule import rule
from gsgen.tiles.errors import Fault
from gsgen.tiles.validation.inspected import InspectedTileset
from gsgen.tiles.validation.kinds import TILESET

SCHEMA_RULE: Final = Fault.SCHEMA.value

# A rule of whole tilesets; one of single contents names their kinds, too.
tileset_rule = partial(rule, over="tileset", kinds=(TILESET,))


def faults_of(inspected: InspectedTileset, fault: Fault) -> Iterator[Violation]:
    """Yield the tileset faults of one kind as violations."""
    for error in inspected.faults.get(fault, ()):
        expected = error.expected or "a file that follows the specification"
        yield Violation.at(f"tileset {error.location}", error.actual, expected)


def certainty(inspected: InspectedTileset) -> Certainty:
    """Return ``confirmed`` for violations in tilesets that gsgen built, else ``possible``."""
    return "confirmed" if inspected.is_built_by_gsgen else "possible"
