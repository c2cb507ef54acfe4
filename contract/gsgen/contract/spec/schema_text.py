"""Descriptions and limits of manifest fields for their JSON Schema."""

__all__ = ["Hint"]

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Hint:
    """Field metadata in ``Annotated[...]`` that becomes JSON Schema keywords."""

    text: str = ""
    minimum: float | None = None
    above: float | None = None
    maximum: float | None = None
    min_length: int | None = None
    pattern: str | None = None
    enum: tuple[str, ...] = ()

    def keywords(self) -> dict[str, object]:
        """Return the field metadata as JSON Schema keywords."""
        by_keyword = {
            "description": self.text or None,
            "minimum": self.minimum,
            "exclusiveMinimum": self.above,
            "maximum": self.maximum,
            "minLength": self.min_length,
            "pattern": self.pattern,
            "enum": list(self.enum) or None,
        }
        return {key: value for key, value in by_keyword.items() if value is not None}
