"""Severity of a rule, and the levels of a validation."""

__all__ = ["Level", "Severity"]

from enum import IntEnum

from gsgen.contract.errors import UnknownName


class _Named(IntEnum):
    """An ordered enumeration whose members are written in lower case."""

    @property
    def word(self) -> str:
        """The name as people type it."""
        return self.name.lower()

    @classmethod
    def words(cls) -> tuple[str, ...]:
        """All names, lowest first."""
        return tuple(member.word for member in cls)


class Severity(_Named):
    """Severity of a violation."""

    INFO = 1
    WARNING = 2
    ERROR = 3

    @classmethod
    def parse(cls, word: str, where: str = "") -> "Severity":
        """Return the severity called ``word``; raise UnknownName if it is unknown."""
        if word.lower() not in cls.words():
            raise UnknownName.among("severity", word, cls.words(), where)
        return cls[word.upper()]


class Level(_Named):
    """Depth of a validation; each level includes the ones before it."""

    STATIC = 1
    VALUES = 2
    BEHAVIOUR = 3
    LIVE = 4
    RENDER = 5

    @classmethod
    def parse(cls, word: str, where: str = "") -> "Level":
        """Return the level called ``word``; raise UnknownName if it is unknown."""
        if word.lower() not in cls.words():
            raise UnknownName.among("level", word, cls.words(), where)
        return cls[word.upper()]
