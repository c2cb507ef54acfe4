"""Severities of rules, and levels of a validation, as ordered enumerations."""

__all__ = ["Level", "Severity"]

from enum import IntEnum
from typing import Self

from gsgen.contract.errors import UnknownName


class _NamedEnum(IntEnum):
    """Base of ordered enumerations whose members users name in lower case."""

    @property
    def word(self) -> str:
        """The lower-case name of a severity or a validation level, as users type it."""
        return self.name.lower()

    @classmethod
    def words(cls) -> tuple[str, ...]:
        """The lower-case names of all members of an enumeration, lowest first."""
        return tuple(member.word for member in cls)

    @classmethod
    def other_words(cls) -> dict[str, str]:
        """Return the words that people type for members: name → words, separated by spaces."""
        return {}

    @classmethod
    def parse(cls, word: str, where: str = "") -> Self:
        """Return the severity or level called ``word``; raise UnknownName if it is unknown."""
        if word.lower() not in cls.words():
            noun = cls.__name__.lower()
            raise UnknownName.among(noun, word, cls.words(), where, cls.other_words())
        return cls[word.upper()]


class Severity(_NamedEnum):
    """The severity of a rule's violation, from info to error."""

    INFO = 1
    WARNING = 2
    ERROR = 3

    @classmethod
    def other_words(cls) -> dict[str, str]:
        """Return the words that people type for severities."""
        return {
            "info": "note notes hint information",
            "warning": "warn warnings",
            "error": "errors err fatal failure",
        }


class Level(_NamedEnum):
    """The depth of a validation, such as static or values; each level includes the lower ones."""

    STATIC = 1
    VALUES = 2
    BEHAVIOUR = 3
    LIVE = 4
    RENDER = 5

    @classmethod
    def other_words(cls) -> dict[str, str]:
        """Return the words that people type for levels."""
        return {
            "static": "fast quick graph structure 1",
            "values": "numbers run 2",
            "behaviour": "behavior default normal 3",
            "live": "stream 4",
            "render": "full all max deep everything pictures 5",
        }
